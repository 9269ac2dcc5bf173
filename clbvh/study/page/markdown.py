"""The tables of a study as Markdown, for documents that quote it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from .html import Section
from .numbers import format_cell
from .parts import Paragraph, Table

_LINE_LENGTH = 120


def write_markdown(sections: Sequence[Section]) -> str:
    """Return headings, paragraphs and tables of all sections; figures and pictures are left out."""
    blocks = []
    for section in sections:
        blocks += [f"## {section.title}", wrap(section.question), wrap(section.method)]
        for part in section.parts:
            if isinstance(part, Paragraph):
                blocks.append(wrap(part.text))
            elif isinstance(part, Table):
                blocks += [wrap(part.caption), write_table(part)]
        blocks += map(wrap, section.notes)
    return "\n\n".join(filter(None, blocks)) + "\n"


def write_table(table: Table) -> str:
    """Return a table without its caption."""
    lines = [_join(table.columns), "|".join(["", *["---"] * len(table.columns), ""])]
    lines += [_join([format_cell(cell) for cell in row]) for row in table.rows]
    return "\n".join(lines)


def _join(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def wrap(text: str) -> str:
    """Return text in lines."""
    return textwrap.fill(text, _LINE_LENGTH, break_long_words=False, break_on_hyphens=False)

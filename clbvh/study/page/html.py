"""The parts of a study as one HTML file: no script, no network, readable on light and dark ground and on a phone."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from ..statistics import NOISY_SPREAD, Summary
from .drawing import use_page_colours
from .numbers import MISSING, format_cell, format_number, format_range
from .parts import Cell, Figure, Paragraph, Part, Picture, Table

_STYLE = """
:root { color-scheme: light dark; --ink: #1c2128; --muted: #5b6570; --ground: #ffffff; --line: #d5dae0;
  --shade: #f4f6f8; --warn: #9a5b00; --published: #6b7480;
  --series-0: #0072b2; --series-1: #d55e00; --series-2: #009e73; --series-3: #aa4499; --series-4: #b8860b;
  --series-5: #4477aa; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ec; --muted: #9aa5b1; --ground: #14181d; --line: #343c46;
  --shade: #1d232a; --warn: #e6a94a; --published: #a3adb8;
  --series-0: #56b4e9; --series-1: #f0885a; --series-2: #33c79b; --series-3: #dd8fc4; --series-4: #f0c24b;
  --series-5: #9cb8e0; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 52rem; padding: 1.2rem; background: var(--ground); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .3rem; padding-top: .8rem; border-top: 1px solid var(--line); }
p { margin: .5rem 0; } .muted, .caption, figcaption, .range { color: var(--muted); } .warn { color: var(--warn); }
nav ul { columns: 14rem; padding-left: 1.2rem; margin: .4rem 0; } a { color: inherit; }
.scroll { overflow-x: auto; margin: 0 0 1rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; width: 100%; }
.caption { font-size: .9rem; margin: 1rem 0 .3rem; }
th, td { text-align: right; vertical-align: top; padding: .25rem .6rem; border-bottom: 1px solid var(--line); }
th { font-weight: 600; vertical-align: bottom; background: var(--shade); }
th:first-child, td:first-child, td.text, th.text { text-align: left; } td.number { white-space: nowrap; }
td.text { min-width: 7rem; } td:first-child { min-width: 0; }
.range { display: block; font-size: .8em; white-space: nowrap; }
figure { margin: 1.2rem 0; } figure svg, figure img { width: 100%; height: auto; display: block; }
figure svg text { fill: currentColor; font-family: system-ui, sans-serif !important; }
figcaption { font-size: .9rem; margin-top: .3rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; font-size: .9rem; }
dt { color: var(--muted); } dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 30rem) { body { padding: .8rem; } dl { grid-template-columns: 1fr; } dd { margin: 0 0 .4rem; }
  th:first-child, td:first-child { position: sticky; left: 0; background: var(--ground); } }
"""


@dataclass(frozen=True)
class Section:
    """One experiment of the page.

    Attributes
    ----------
    name, title, question, method : str
        See `Experiment`.
    parts : sequence of Part
    notes : sequence of str
        What was not measured, and noise.
    """

    name: str
    title: str
    question: str
    method: str
    parts: Sequence[Part]
    notes: Sequence[str] = ()


def write_page(title: str, introduction: Sequence[str], facts: dict[str, str], sections: Sequence[Section]) -> str:
    """Return the whole page.

    Parameters
    ----------
    title : str
    introduction : sequence of str
        Paragraphs.
    facts : dict of str to str
        The machine.
    sections : sequence of Section
    """
    links = "".join(f'<li><a href="#{escape(one.name)}">{escape(one.title)}</a></li>' for one in sections)
    machine = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items())
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n"
        + "".join(f"<p>{escape(text)}</p>\n" for text in introduction)
        + f"<nav><ul>{links}</ul></nav>\n"
        f'<section id="machine"><h2>Machine</h2><dl>{machine}</dl></section>\n'
        + "".join(map(_write_section, sections))
        + "</body>\n</html>\n"
    )


def _write_section(section: Section) -> str:
    parts = [
        f"<h2>{escape(section.title)}</h2>",
        f"<p>{escape(section.question)}</p>",
        f'<p class="muted">{escape(section.method)}</p>' if section.method else "",
        *(_write_part(part, f"{section.name}-{number}", section.title) for number, part in enumerate(section.parts)),
        *(f'<p class="warn">{escape(note)}</p>' for note in section.notes),
    ]
    return f'<section id="{escape(section.name)}">\n' + "\n".join(filter(None, parts)) + "\n</section>\n"


def _write_part(part: Part, name: str, title: str) -> str:
    if isinstance(part, Paragraph):
        return f"<p>{escape(part.text)}</p>"
    if isinstance(part, Table):
        return _write_table(part, f"{name}-caption")
    caption = f"<figcaption>{escape(part.caption)}</figcaption>"
    label = escape(f"{title}: {part.caption}", quote=True)
    if isinstance(part, Picture):
        content = base64.b64encode(part.png).decode()
        return f'<figure><img alt="{label}" src="data:image/png;base64,{content}">{caption}</figure>'
    if not part.svg:
        return ""
    drawing = use_page_colours(part.svg, name).replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
    return f"<figure>{drawing}{caption}</figure>"


def _write_table(table: Table, caption_id: str) -> str:
    is_text = [all(isinstance(row[column], str) or row[column] is None for row in table.rows)
               and any(isinstance(row[column], str) for row in table.rows)
               for column in range(len(table.columns))]  # fmt: skip
    heads = "".join(
        f'<th scope="col"{" class=text" if text else ""}>{escape(name)}</th>'
        for name, text in zip(table.columns, is_text, strict=True)
    )
    rows = "".join(
        "<tr>" + "".join(_write_cell(cell, text) for cell, text in zip(row, is_text, strict=True)) + "</tr>\n"
        for row in table.rows
    )
    return (
        # Outside of the table, whose width it would take on a phone.
        f'<p class="caption" id="{caption_id}">{escape(table.caption)}</p>\n'
        f'<div class="scroll"><table aria-labelledby="{caption_id}">\n'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>"
    )


def _write_cell(cell: Cell, is_text: bool) -> str:
    if isinstance(cell, Summary):
        spread = format_range(cell)
        shown = f'<span class="range">{spread}</span>' if spread else ""
        noisy = f' class="number warn" title="the samples lie more than {100 * NOISY_SPREAD:.0f} % apart"'
        return f"<td{noisy if cell.is_noisy else ' class=number'}>{format_number(cell.median)}{shown}</td>"
    text = MISSING if cell is None else format_cell(cell)
    return f"<td class={'text' if is_text else 'number'}>{escape(text)}</td>"


__all__ = ["Figure", "Section", "write_page"]

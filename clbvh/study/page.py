"""The parts of a study's page, without their form, and the page: as HTML, and as Markdown for documents that quote it.

The forms and their standing texts are the templates beside this file.
"""

from __future__ import annotations

import math
import textwrap
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .drawing import Axis, Point, draw_figure
from .statistics import NOISY_SPREAD, Summary

if TYPE_CHECKING:
    from jinja2 import Environment

HTML, RESULTS, README = "page.html.jinja", "results.md.jinja", "readme.md.jinja"
_CAPTIONS = "captions.md.jinja"

# What a cell of a table can be. A summary shows its median and its range.
Cell = str | int | float | Summary | None
Rows = list[tuple[Cell, ...]]

_DIGITS, _MOST_DECIMALS = 3, 6
_MISSING = "\u2013"  # a dash
_LINE_LENGTH = 120


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes
    ----------
    caption : str
    columns : sequence of str
        The headings, with units.
    rows : sequence of sequence of Cell
        None, or not a number, where there is no figure.
    """

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Figure:
    """A drawing: curves over `x`, or horizontal bars without it.

    Attributes
    ----------
    caption : str
    points : sequence of Point
    y : Axis
        Of the values.
    x : Axis, optional
    """

    caption: str
    points: Sequence[Point]
    y: Axis
    x: Axis | None = None

    @property
    def address(self) -> str:
        """The drawing itself as an address."""
        return f"data:image/svg+xml;base64,{b64encode(draw_figure(self.points, self.y, self.x)).decode()}"


@dataclass(frozen=True)
class Picture:
    """A rendered picture."""

    caption: str
    png: bytes

    @property
    def address(self) -> str:
        """The picture itself as an address."""
        return f"data:image/png;base64,{b64encode(self.png).decode()}"


# Plain text is a paragraph.
Part = str | Table | Figure | Picture


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


def render(template: str, **content: Any) -> str:
    """Return a document: one of the templates `HTML`, `RESULTS` and `README` with its content."""
    return _load_templates().get_template(template).render(content)


def write_caption(name: str, *values: Any, **context: Any) -> str:
    """Return a longer caption or a paragraph of `captions.md.jinja` as one line."""
    captions = _load_templates().get_template(_CAPTIONS).make_module(context)
    return " ".join(getattr(captions, name)(*values).split())


@cache
def _load_templates() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=select_autoescape(["html.jinja"]),
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined,
    )  # fmt: skip
    environment.filters |= {"cell": format_cell, "number": format_number, "table": write_table, "wrap": wrap}
    environment.globals["apart"] = f"{100 * NOISY_SPREAD:.0f} %"
    return environment


def wrap(text: str) -> str:
    """Return text in lines."""
    return textwrap.fill(text, _LINE_LENGTH, break_long_words=False, break_on_hyphens=False)


def write_table(table: Table) -> str:
    """Return a table in Markdown, without its caption."""
    rows = [table.columns, ["---"] * len(table.columns), *([format_cell(cell) for cell in row] for row in table.rows)]
    lines = [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows]
    lines[1] = lines[1].replace(" ", "")
    return "\n".join(lines)


def format_cell(cell: Cell) -> str:
    """Return a cell of a table in plain text."""
    if cell is None:
        return _MISSING
    if isinstance(cell, Summary):
        median, low, high = map(format_number, (cell.median, cell.low, cell.high))
        return f"{median} ({low} to {high})" if cell.count > 1 else median
    return cell if isinstance(cell, str) else format_number(cell)


def format_number(value: float) -> str:
    """Return a number with three significant digits; whole numbers in full."""
    if isinstance(value, int):
        return f"{value:,}"
    if not math.isfinite(value):
        return _MISSING
    if value == 0:
        return "0"
    decimals = max(0, _DIGITS - 1 - math.floor(math.log10(abs(value))))
    return f"{value:,.{min(decimals, _MOST_DECIMALS)}f}"

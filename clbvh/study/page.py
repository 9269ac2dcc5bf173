"""The parts of a study's page, and the page: as HTML, and as Markdown for documents that quote it.

The forms and their standing texts are the templates beside this file. Figures are SVG, drawn by matplotlib in one
style: series differ in colour and marker, and the colours are those that colour-blind people can tell apart. The same
figure is the same file.
"""

from __future__ import annotations

import io
import math
import textwrap
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .statistics import NOISY_SPREAD, Summary

if TYPE_CHECKING:
    from jinja2 import Environment

HTML, RESULTS, README = "page.html.jinja", "results.md.jinja", "readme.md.jinja"
_CAPTIONS = "captions.md.jinja"

# What a cell of a table can be. A summary shows its median and its range; None, or not a number, is no figure.
Cell = str | int | float | Summary | None

_DIGITS, _MOST_DECIMALS = 3, 6
_MISSING = "\u2013"  # a dash
_LINE_LENGTH = 120


# The name of the series that the report published.
REPORT = "the report"

# The series, x or the name of the bar, and the value: a summary has an error bar from its smallest to its largest
# sample. None and summaries of no samples are left out.
Point = tuple[str, Any, Any]

_MARKERS = ("o", "s", "D", "^", "v", "P")

# At 6.4 inches the figure fills the page's column; at half of that, text of 11 points is still read.
_WIDTH_INCHES, _CURVES_INCHES = 6.4, 3.6
_BAR_INCHES = 0.36
_BAR_MARGIN_INCHES = 0.95
_LEGEND_COLUMNS = 4
# Ranges below this ratio get more numbers on a logarithmic axis: powers of ten alone would leave one or none.
_SHORT_RANGE = 50
_STYLE: Any = {
    "font.size": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.alpha": 0.4,
    "svg.fonttype": "none",
    "svg.hashsalt": "clbvh",
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes
    ----------
    caption : str
    columns : sequence of str
        The headings, with units.
    rows : sequence of sequence of Cell
    is_detail : bool
        Only on the page of a study, not in the document that quotes it.
    """

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    is_detail: bool = False


@dataclass(frozen=True)
class Axis:
    """The label of an axis, with its unit, and its scale.

    Attributes
    ----------
    label : str
    is_log : bool
    ticks : sequence of float
        The values with a number; chosen by the figure without them.
    """

    label: str
    is_log: bool = False
    ticks: Sequence[float] = ()


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
        return f"data:image/svg+xml;base64,{b64encode(self.draw()).decode()}"

    def draw(self) -> bytes:
        """Return the drawing as an SVG file."""
        return draw_figure(self.points, self.y, self.x)


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

    @property
    def tables(self) -> list[Table]:
        """Those that a document quotes."""
        return [part for part in self.parts if isinstance(part, Table) and not part.is_detail]


def draw_figure(points: Sequence[Point], y: Axis, x: Axis | None = None) -> bytes:
    """Return a figure as an SVG file: curves over `x`, or without it horizontal bars, the first point's at the top."""
    import matplotlib.style
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(name for name, *_ in points))
    bars = list(dict.fromkeys(at for _, at, _ in points))
    drawn = [(name, at, value if isinstance(value, Summary) else Summary.of([] if value is None else [value]))
             for name, at, value in points]  # fmt: skip
    height = _CURVES_INCHES
    if x is None:
        height = _BAR_MARGIN_INCHES + _BAR_INCHES * max(len(bars), 2) * max(1.0, len(names) / 2)
    with matplotlib.style.context(["tableau-colorblind10", _STYLE]):
        figure = Figure(figsize=(_WIDTH_INCHES, height), layout="constrained")
        axes = figure.subplots()
        for number, name in enumerate(names):
            shown = [(at, value) for series, at, value in drawn if series == name and value.count]
            medians = [value.median for _, value in shown]
            errors = [[one.median - one.low for _, one in shown], [one.high - one.median for _, one in shown]]
            if x is not None:
                style: Any = {"marker": _MARKERS[number % len(_MARKERS)], "linestyle": ":" if name == REPORT else "-"}
                axes.errorbar([at for at, _ in shown], medians, errors, label=name, capsize=3, **style)
            else:
                thickness = 0.8 / len(names)
                positions = [bars.index(at) - 0.4 + thickness * (number + 0.5) for at, _ in shown]
                axes.barh(positions, medians, 0.9 * thickness, xerr=errors, label=name, capsize=2)
        if x is not None:
            _set_axis(axes.xaxis, x)
            _set_axis(axes.yaxis, y)
            axes.set_ylim(bottom=None if y.is_log else 0)
        else:
            axes.set_yticks(range(len(bars)), bars)
            axes.invert_yaxis()
            _set_axis(axes.xaxis, y)
        axes.grid(axis="x" if x is None else "both")
        if len(names) > 1:
            # Above the axes, where it covers nothing.
            figure.legend(loc="outside upper left", ncols=min(len(names), _LEGEND_COLUMNS), borderaxespad=0.2)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def _set_axis(axis: Any, wanted: Axis) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis.set_label_text(wanted.label)
    if wanted.is_log:
        axis._set_axes_scale("log")
        axis.set_minor_formatter(NullFormatter())
        low, high = axis.get_view_interval()
        if high < _SHORT_RANGE * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    if wanted.ticks:
        axis.set_ticks(list(wanted.ticks))
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))


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
    environment.filters |= {"cell": format_cell, "first_sentence": first_sentence, "number": format_number}
    environment.filters |= {"table": write_table, "wrap": wrap}
    environment.globals["apart"] = f"{100 * NOISY_SPREAD:.0f} %"
    return environment


def wrap(text: str) -> str:
    """Return text in lines."""
    return textwrap.fill(text, _LINE_LENGTH, break_long_words=False, break_on_hyphens=False)


def first_sentence(text: str) -> str:
    """Return the first sentence of a caption."""
    return text.partition(". ")[0].removesuffix(".") + "."


def write_table(table: Table) -> str:
    """Return a table in Markdown, without its caption and with medians alone."""
    cells = [[format_cell(cell.median if isinstance(cell, Summary) else cell) for cell in row] for row in table.rows]
    rows = [table.columns, ["---"] * len(table.columns), *cells]
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

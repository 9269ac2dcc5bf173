"""Figures as SVG, drawn by matplotlib: curves and bars in one style.

Without matplotlib there are none; the tables have every number. Text and lines take the page's own colours, so that a
figure is readable on light and on dark ground. Series differ in colour, marker and line, and the colours are those that
colour-blind people can tell apart (M. Okabe and K. Ito, "Color universal design", 2008).
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..statistics import Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours that stand for those of the page's style sheet: the page replaces them.
_INK = "#010203"
_SERIES = tuple(f"#0102{number:02x}" for number in range(0x10, 0x16))
_PUBLISHED = "#010220"

_MARKERS = "osD^vP"
_LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)), (0, (3, 1)))

# At 6.4 inches the figure fills the page's column; at half of that, text of 11 points is still read.
_SIZE_INCHES = (6.4, 3.6)
_BAR_INCHES = 0.36
_BAR_MARGIN_INCHES = 0.95
_LEGEND_COLUMNS = 4
# Ranges below this ratio get more numbers on a logarithmic axis.
_FEW_DECADES = 50
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 11,
    "text.color": _INK,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "clbvh",
    "legend.frameon": False,
}
_GRID: Any = {"color": _INK, "alpha": 0.15, "linewidth": 0.8}


@dataclass(frozen=True)
class Series:
    """One curve, or the bars of one colour.

    Attributes
    ----------
    name : str
    x : sequence of float
    y : sequence of Summary or float
        A summary has an error bar from its smallest to its largest sample.
    is_published : bool
        Whether the report had it.
    """

    name: str
    x: Sequence[float]
    y: Sequence[Summary | float]
    is_published: bool = False


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
    ticks: Sequence[float] = field(default_factory=tuple)


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    try:
        import matplotlib as matplotlib
    except ImportError:
        return False
    return True


def draw_curves(x: Axis, y: Axis, series: Sequence[Series]) -> str:
    """Return a figure of curves as SVG, empty where it cannot be drawn.

    Parameters
    ----------
    x, y : Axis
    series : sequence of Series
        Those without points are left out.
    """
    shown = [one for one in series if len(one.x)]
    if not can_draw() or not shown:
        return ""
    with _figure(_SIZE_INCHES) as (figure, axes):
        number = 0
        for one in shown:
            medians = [_median(value) for value in one.y]
            if one.is_published:
                style: dict[str, Any] = {"color": _PUBLISHED, "marker": "o", "markerfacecolor": "none",
                                         "linestyle": (0, (1, 1.5))}  # fmt: skip
            else:
                style = {"color": _SERIES[number % len(_SERIES)], "marker": _MARKERS[number % len(_MARKERS)],
                         "linestyle": _LINES[number % len(_LINES)]}  # fmt: skip
                number += 1
            axes.errorbar(
                one.x, medians, yerr=_errors(one), label=one.name, capsize=3, linewidth=1.8, markersize=6, **style
            )
        _label(axes.xaxis, x)
        _label(axes.yaxis, y)
        if not y.is_log:
            axes.set_ylim(bottom=0)
        axes.grid(**_GRID)
        _add_legend(figure, len(shown))
        return _as_svg(figure)


def draw_bars(value: Axis, names: Sequence[str], series: Sequence[Series]) -> str:
    """Return a figure of horizontal bars as SVG, empty where it cannot be drawn.

    Parameters
    ----------
    value : Axis
        Of the lengths of the bars.
    names : sequence of str
        One for each group of bars, from the top.
    series : sequence of Series
        Bars of one colour; `x` are indices of `names`.
    """
    shown = [one for one in series if len(one.x)]
    if not can_draw() or not shown:
        return ""
    height = _BAR_MARGIN_INCHES + _BAR_INCHES * max(len(names), 2) * max(1.0, len(shown) / 2)
    with _figure((_SIZE_INCHES[0], height)) as (figure, axes):
        thickness = 0.8 / len(shown)
        number = 0
        for row, one in enumerate(shown):
            positions = [index - 0.4 + thickness * (row + 0.5) for index in one.x]
            medians = [_median(value) for value in one.y]
            colour = _PUBLISHED if one.is_published else _SERIES[number % len(_SERIES)]
            number += not one.is_published
            axes.barh(positions, medians, thickness * 0.9, xerr=_errors(one), label=one.name, color=colour,
                      error_kw={"ecolor": _INK, "capsize": 2, "linewidth": 1})  # fmt: skip
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        _label(axes.xaxis, value)
        axes.grid(axis="x", **_GRID)
        if len(shown) > 1:
            _add_legend(figure, len(shown))
        return _as_svg(figure)


def use_page_colours(svg: str, prefix: str) -> str:
    """Return a figure with the page's colours, and with names that no other figure of the page has.

    Parameters
    ----------
    svg : str
        From `draw_curves` or `draw_bars`.
    prefix : str
        Unique on the page.
    """
    svg = svg.replace(_INK, "currentColor").replace(_PUBLISHED, "var(--published)")
    for number, colour in enumerate(_SERIES):
        svg = svg.replace(colour, f"var(--series-{number})")
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    return re.sub(r'(xlink:href="|url\()#', rf"\1#{prefix}-", svg)


@contextmanager
def _figure(inches: tuple[float, float]) -> Iterator[tuple[Figure, Any]]:
    """Yield an empty figure in the study's style, without a window system."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=inches, layout="constrained")
        figure.patch.set_alpha(0)
        axes = figure.subplots()
        axes.patch.set_alpha(0)
        axes.set_axisbelow(True)
        yield figure, axes


def _add_legend(figure: Figure, count: int) -> None:
    """Name the series above the axes, where they cover nothing."""
    figure.legend(loc="outside upper left", ncols=min(count, _LEGEND_COLUMNS), borderaxespad=0.2)


def _label(axis: Any, wanted: Axis) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    from .numbers import format_number

    axis.set_label_text(wanted.label)
    if wanted.is_log:
        axis._set_axes_scale("log")
        axis.set_minor_formatter(NullFormatter())
        low, high = axis.get_view_interval()
        if high < _FEW_DECADES * low:
            # Powers of ten alone would leave one number or none.
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    if wanted.ticks:
        axis.set_ticks(list(wanted.ticks))
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: _shorten(value, format_number)))


def _shorten(value: float, format_number: Any) -> str:
    """Return a tick's number: 10 k, 2 M; in full where that would not be short."""
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if value >= size and value * 10 % size == 0:
            return f"{value / size:g} {unit}"
    return f"{value:g}" if value < 1e4 else str(format_number(int(value)))


def _as_svg(figure: Figure) -> str:
    """Return the drawing alone: no declaration, no metadata, no address of a name space."""
    content = io.StringIO()
    figure.savefig(content, format="svg", transparent=True, metadata={"Date": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    # The page's own width.
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    return re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)


def _errors(series: Series) -> list[list[float]] | None:
    """Return the distances from the medians to the smallest and the largest samples, None where there are none."""
    pairs = [(value.median - value.low, value.high - value.median) for value in series.y if isinstance(value, Summary)]
    return [list(side) for side in zip(*pairs, strict=True)] if len(pairs) == len(series.y) else None


def _median(value: Summary | float) -> float:
    return value.median if isinstance(value, Summary) else value

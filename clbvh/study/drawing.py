"""Figures as SVG, drawn by matplotlib: curves and bars in one style.

Series differ in colour and marker, and the colours are those that colour-blind people can tell apart. The same figure
is the same file.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .statistics import Summary

# The name of the series that the report published.
REPORT = "the report"

# The series, x or the name of the bar, and the value: a summary has an error bar from its smallest to its largest
# sample. None and summaries of no samples are left out.
Point = tuple[str, Any, Summary | float | None]

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

"""A figure of a tree: the histograms of the sizes and depths of its leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..support.files import check_target, write_atomically
from .tree_stats import Bar, TreeStats, gather_bars

PLOT_SUFFIX = ".png"

# The figure has 1500 x 750 pixels: sharp on a slide, and small enough for a screen.
_SIZE_INCHES = (10, 5)
_DPI = 150

_MOST_BARS = 40
# With more bars than this, the numbers on them would touch each other.
_MOST_LABELS = 12
# As a share of the distance from one bar to the next.
_BAR_WIDTH = 0.82
# From the centre of the outermost bar to the edge, in bars.
_MARGIN = 0.7
# The height of the axis relative to the highest bar: room for the number above it.
_HEADROOM = 1.1
# Distance from the axis to its numbers, in points: room for the mark of the mean.
_TICK_PAD = 9

_INK, _MUTED, _GRID = "#20262e", "#66707c", "#e3e7ec"
_SIZE_COLOUR, _DEPTH_COLOUR = "#2f6f9f", "#c7772e"
_MUTED_PARTS = ("axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
_HIDDEN_PARTS = ("axes.spines.top", "axes.spines.right", "axes.spines.left")
_STYLE: Any = {"text.color": _INK, **dict.fromkeys(_MUTED_PARTS, _MUTED), **dict.fromkeys(_HIDDEN_PARTS, False)}


def check_plot_path(path: Path) -> None:
    """Raise `ConfigError` unless a plot can be drawn and written there; for checks before the work begins."""
    check_target(path, "a plot", (PLOT_SUFFIX,))
    try:
        import matplotlib as matplotlib
    except ImportError as error:
        raise ConfigError(f"a plot needs matplotlib: run 'pip install \"clbvh[study]\"' ({error})") from error


def write_tree_plot(path: Path, stats: TreeStats, title: str) -> None:
    """Draw a tree's histograms into a PNG file.

    Parameters
    ----------
    path : Path
    stats : TreeStats
    title : str
        The heading: mesh and builder.

    Raises
    ------
    ConfigError
        Matplotlib is not installed, or the file cannot be written there.
    """
    check_plot_path(path)
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        figure = _draw(stats, title)
        write_atomically(path, lambda file: figure.savefig(file, format="png", facecolor="white"))


def _draw(stats: TreeStats, title: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCHES, dpi=_DPI)
    sizes, depths = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1, 1.6)})
    figure.subplots_adjust(left=0.085, right=0.98, top=0.74, bottom=0.09, wspace=0.13)

    # Matplotlib takes an unescaped dollar sign for the start of a formula.
    figure.text(0.02, 0.925, title.replace("$", r"\$"), fontsize=15, fontweight="bold")
    figure.text(0.02, 0.87, _summary(stats), color=_MUTED)
    for axes, histogram, colour, heading, mean in (
        (sizes, stats.leaf_sizes, _SIZE_COLOUR, "Triangles in a leaf", stats.mean_leaf_size),
        (depths, stats.leaf_depths, _DEPTH_COLOUR, "Depth of a leaf", stats.mean_leaf_depth),
    ):
        _draw_bars(axes, gather_bars(histogram, _MOST_BARS), stats.leaf_count, colour)
        axes.plot([mean], [0], "D", markersize=7, color="white", markeredgecolor=_INK, clip_on=False, zorder=4)
        axes.set_title(f"{heading}: mean {mean:.2f}", loc="left", fontsize=11, fontweight="bold", pad=10)
    sizes.set_ylabel("share of all leaves")
    return figure


def _summary(stats: TreeStats) -> str:
    sampled = "" if stats.epo_triangles == stats.triangle_count else " (sampled)"
    facts = (
        f"triangles {stats.triangle_count:,}",
        f"nodes {stats.node_count:,}",
        f"leaves {stats.leaf_count:,}",
        f"SAH cost {stats.sah_cost:.2f}",
        f"EPO {stats.epo:.2f}{sampled}",
        f"{stats.host_bytes_per_triangle:.0f} bytes per triangle",
    )
    return "   ·   ".join(facts)


def _draw_bars(axes: Any, bars: list[Bar], total: int, colour: str) -> None:
    """Draw a histogram as shares of all leaves, with numbers on the bars where there is room."""
    width = bars[0].last + 1 - bars[0].first
    centres = [bar.first + (width - 1) / 2 for bar in bars]
    shares = [bar.count / total for bar in bars]
    drawn = axes.bar(centres, shares, width=_BAR_WIDTH * width, color=colour, zorder=2)
    if len(bars) <= _MOST_LABELS:
        axes.bar_label(drawn, [_percent(share) for share in shares], padding=2, fontsize=9, color=_INK)
        axes.set_xticks(centres, [bar.label for bar in bars])
    else:
        axes.xaxis.get_major_locator().set_params(integer=True)

    axes.set_xlim(centres[0] - _MARGIN * width, centres[-1] + _MARGIN * width)
    axes.set_ylim(0, _HEADROOM * max(shares))
    axes.yaxis.set_major_formatter(lambda share, position: f"{100 * share:.3g} %")
    axes.grid(axis="y", color=_GRID, linewidth=0.8, zorder=0)
    axes.tick_params(length=0)
    axes.tick_params(axis="x", pad=_TICK_PAD)


def _percent(share: float) -> str:
    """Return a share in percent without decimals; empty for 0."""
    if share == 0:
        return ""
    return "<1 %" if share < 0.01 else f"{100 * share:.0f} %"

"""`clbvh stats`: the parts of a mesh's tree, measures of its quality, and the time of each phase.

A scene of several objects has trees in two levels, which the second half of this file shows.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..builders.tree_options import TreeOptions
from . import options
from .tables import describe_count, describe_scene, join_facts, make_facts, make_table, make_times, print_report

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..bvh import Bvh
    from ..geometry import Shape
    from ..rendering.view import View
    from ..scene.state import SceneState
    from ..stats import TreeStats
    from ..support.stopwatch import Stopwatch

_MIB = 1 << 20

# Size of the histograms in the terminal.
_MOST_ROWS = 16
_BAR_CELLS = 40

# Most geometries of a scene that the table shows.
_MOST_GEOMETRIES = 40

_EXACT_HELP = "Measure the end-point overlap on all triangles, not on at most 200,000."
_PLOT_HELP = "Draw the histograms of leaf sizes and depths."


@options.with_options(tree=options.list_tree_options(TreeOptions, without=("cache", "cache_dir")))
def stats(
    source: options.Source,
    /,
    *,
    exact: Annotated[bool, Parameter(help=_EXACT_HELP)] = False,
    rays: Annotated[bool, Parameter(help="Count node steps and triangle tests per ray.")] = False,
    plot: Annotated[Path | None, Parameter(metavar="FILE.png", help=_PLOT_HELP)] = None,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Build a tree and measure it."""
    from ..builders.tree_cache import get_tree
    from ..errors import ConfigError
    from ..geometry import Mesh
    from ..rendering.open_scene import open_scene
    from ..stats import measure_tree
    from ..stats.tree_plot import check_plot_path, write_tree_plot
    from ..stats.tree_stats import OVERLAP_SAMPLE
    from ..support.stopwatch import Stopwatch

    # All input is checked before any work.
    if plot is not None:
        check_plot_path(plot)
    wanted = options.make_options(TreeOptions, tree)
    watch = Stopwatch()
    scene, view = open_scene(source)
    state = scene.snapshot()
    watch.lap("load")
    mesh = state.shapes[0] if state.is_one_mesh else None
    if not isinstance(mesh, Mesh):
        for option, is_given in {"--exact": exact, "--rays": rays, "--plot": plot is not None}.items():
            if is_given:
                raise ConfigError(f"{option} measures the tree of one mesh, and {source} has several objects")
        _show_scene_stats(state, wanted, watch, as_json=as_json)
        return

    made = get_tree(mesh, wanted)
    watch.lap("build")
    sample = None if exact else OVERLAP_SAMPLE
    measured = measure_tree(made.bvh, traversal_cost=wanted.build.traversal_cost, overlap_sample=sample)
    watch.lap("measure")
    costs = _measure_rays(made.bvh, view) if rays else {}
    if rays:
        watch.lap("rays")
    build = _report_build(wanted, made.workers, watch) | {"phases_ms": dict(made.bvh.timings_ms)}
    if plot is not None:
        write_tree_plot(plot, measured, f"{mesh.name}, builder {wanted.builder}")
    facts = {
        "name": mesh.name,
        "vertices": len(mesh.vertices),
        "triangles": mesh.face_count,
        "degenerate_triangles": mesh.degenerate_count,
        "size": (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).tolist(),
        "centre": mesh.origin.tolist(),
        "bytes": mesh.vertices.nbytes + mesh.local_vertices.nbytes + mesh.faces.nbytes,
    }
    report = {"mesh": facts, "build": build, "tree": measured.as_dict(), **({"rays": costs} if rays else {})}
    histograms = (
        _make_histogram(heading, counts, measured.leaf_count)
        for heading, counts in (("triangles", measured.leaf_sizes), ("depth", measured.leaf_depths))
    )
    shown = make_facts(_describe_mesh(facts, build) | _describe_tree(measured) | _describe_rays(costs))
    print_report(report, shown, *histograms, _make_times(build), as_json=as_json)


def _measure_rays(bvh: Bvh, view: View) -> dict[str, dict[str, float]]:
    """Return the mean counts per ray, for each kind of rays."""
    from ..rendering.cameras.bounds import SceneBounds
    from ..rendering.heat_map import mean_steps, measure_rays
    from ..rendering.view_finder import ViewFinder

    finder = ViewFinder(SceneBounds.of_mesh(bvh.mesh))
    steps = measure_rays(bvh, finder.camera(finder.complete(view)), view.width / view.height)
    return {
        kind: {
            "rays": len(counted),
            "hit": float((counted["prim_id"] >= 0).mean()) if len(counted) else 0.0,
            **mean_steps(counted),
        }
        for kind, counted in steps.items()
    }


def _describe_mesh(mesh: dict[str, Any], build: dict[str, Any]) -> dict[str, str]:
    degenerate = f"{mesh['degenerate_triangles']:,} degenerate" if mesh["degenerate_triangles"] else ""
    triangles, vertices = describe_count(mesh["triangles"], "triangle"), f"{mesh['vertices']:,} vertices"
    return {
        "mesh": join_facts(mesh["name"], triangles, vertices, degenerate),
        "size": _format_size(mesh["size"]),
        "centre": ", ".join(f"{coordinate:.9g}" for coordinate in mesh["centre"]),
        "built by": _describe_builder(build),
    }


def _describe_tree(measured: TreeStats) -> dict[str, str]:
    is_sampled = measured.epo_triangles < measured.triangle_count
    sample = f"on a sample of {measured.epo_triangles:,} triangles" if is_sampled else ""
    per_triangle = "bytes per triangle"
    return {
        "nodes": f"{measured.node_count:,}: {measured.interior_count:,} interior, {measured.leaf_count:,} leaves",
        "depth": f"{measured.depth}; mean depth of a leaf {measured.mean_leaf_depth:.2f}",
        "SAH cost": f"{measured.sah_cost:.3f}, with a traversal cost of {measured.traversal_cost:g}",
        "EPO": join_facts(f"{measured.epo:.3f}", sample),
        "on the host": f"{_format_mib(measured.host_bytes)}, {measured.host_bytes_per_triangle:.1f} {per_triangle}",
    } | {
        f"as {layout}": f"{_format_mib(measured.device_bytes[layout])}, {size:.1f} {per_triangle}, triangles included"
        for layout, size in measured.device_bytes_per_triangle.items()
    }


def _describe_rays(costs: dict[str, dict[str, float]]) -> dict[str, str]:
    return {
        f"{kind} rays": f"{cost['tests']:.2f} tests: {cost['node_steps']:.2f} node steps, "
        f"{cost['triangle_tests']:.2f} triangles; {100 * cost['hit']:.1f} % of {cost['rays']:,} hit"
        for kind, cost in costs.items()
    }


def _make_histogram(heading: str, counts: tuple[int, ...], total: int) -> Any:
    """Return a table of bars."""
    from rich.console import Console

    from ..stats.tree_stats import gather_bars

    bars = gather_bars(counts, _MOST_ROWS)
    highest = max(bar.count for bar in bars)
    sign = "█" if Console().encoding.startswith("utf") else "#"

    def list_rows() -> Iterator[tuple[str, ...]]:
        for bar in bars:
            # A bar that is not empty has at least one cell.
            cells = max(round(_BAR_CELLS * bar.count / highest), bar.count > 0)
            yield bar.label, f"{bar.count:,}", f"{100 * bar.count / total:.1f} %", sign * cells

    return make_table((heading, "leaves", "", ""), list_rows(), numbers=(heading, "leaves"))


def _report_build(wanted: TreeOptions, workers: int, watch: Stopwatch) -> dict[str, Any]:
    """Return the builder, its options, and the times of the phases, for JSON."""
    from ..support.stopwatch import add_total

    timings_ms = add_total(watch.laps_ms, watch.total_ms)
    return {"builder": wanted.builder, **asdict(wanted.build), "workers": workers, "timings_ms": timings_ms}


def _describe_builder(build: dict[str, Any]) -> str:
    return f"{build['builder']}, {describe_count(build['workers'], 'worker')}"


def _make_times(build: dict[str, Any]) -> Any:
    """Return the table of all phases; those of the build of one tree are indented, and add up to it."""
    from ..support.stopwatch import add_total

    rows: dict[str, float] = {}
    for phase, ms in build["timings_ms"].items():
        rows[phase] = ms
        if phase == "build" and "phases_ms" in build:
            parts_ms = add_total(build["phases_ms"], ms)
            rows |= {f"  {part}": part_ms for part, part_ms in parts_ms.items() if part != "total"}
    return make_times(rows.items())


def _format_mib(size: int) -> str:
    return f"{size / _MIB:,.1f} MiB"


def _format_size(sides: list[float]) -> str:
    return " x ".join(f"{side:.6g}" for side in sides)


def _show_scene_stats(state: SceneState, wanted: TreeOptions, watch: Stopwatch, *, as_json: bool) -> None:
    """Build the trees of a scene, and print their measures; the watch has measured the load."""
    from ..builders.tree_cache import get_tree
    from ..rendering.scene_stats import measure_scene

    workers = 1

    def build_tree(shape: Shape) -> Bvh:
        nonlocal workers
        watch.lap("measure")
        made = get_tree(shape, wanted)
        watch.lap("build")
        workers = max(workers, made.workers)
        return made.bvh

    measured = measure_scene(state, build_tree, traversal_cost=wanted.build.traversal_cost)
    watch.lap("measure")
    build = _report_build(wanted, workers, watch)
    top, geometries = measured["instances"], measured["geometries"]
    has_more = len(geometries) > _MOST_GEOMETRIES
    facts = {
        "scene": describe_scene(top["instance_count"], len(geometries), measured["prim_count"]),
        "size": _format_size(
            [upper - lower for lower, upper in zip(measured["lower"], measured["upper"], strict=True)]
        ),
        "built by": _describe_builder(build),
        **{f"as {layout}": f"{_format_mib(size)}, both levels" for layout, size in measured["device_bytes"].items()},
        "below": f"the {_MOST_GEOMETRIES} largest geometries; --json has all of them" if has_more else "",
    }
    of_top = {
        "instances": f"{top['instance_count']:,}, in a tree of {top['node_count']:,} nodes",
        "depth": f"{top['depth']}",
        "SAH cost": f"{top['sah_cost']:.3f}, where entering an instance costs 1",
        "on the device": f"{top['device_bytes'] / _MIB:,.2f} MiB, "
        f"{top['device_bytes_per_instance']:.1f} bytes an instance",
    }
    report = {"scene": measured, "build": build}
    tables = make_facts(facts), _make_geometry_table(geometries), make_facts(of_top), _make_times(build)
    print_report(report, *tables, as_json=as_json)


def _make_geometry_table(geometries: list[dict[str, Any]]) -> Any:
    """Return one row for each geometry; in a scene of very many, for each of the largest ones."""
    from rich.markup import escape

    largest = sorted(geometries, key=lambda geometry: -geometry["prim_count"])[:_MOST_GEOMETRIES]
    rows = (
        (
            escape(geometry["name"]),
            f"{geometry['prim_count']:,} {geometry['kind']}",
            f"{geometry['instance_count']:,}",
            f"{geometry['node_count']:,}",
            f"{geometry['depth']}",
            f"{geometry['sah_cost']:.3f}",
            f"{geometry['device_bytes']['bvh2'] / _MIB:,.2f} MiB",
        )
        for geometry in geometries
        if geometry in largest
    )
    numbers = "primitives", "instances", "nodes", "depth", "SAH cost", "as bvh2"
    return make_table(("geometry", *numbers), rows, numbers=numbers)

"""`clbvh stats`: the parts of trees, measures of their quality, and the time of each phase.

A mesh has one tree. A scene has one for each geometry, and one over the instances.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..builders.tree_options import TreeOptions
from . import options
from .tables import (
    describe_count,
    describe_scene,
    describe_workers,
    join_facts,
    make_facts,
    make_table,
    make_times,
    print_report,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from ..bvh import Bvh
    from ..device.info import DeviceInfo
    from ..views.view import View

_MIB = 1 << 20

# Size of the histograms in the terminal.
_MOST_ROWS = 16
_BAR_CELLS = 40

# Most geometries of a scene that the table shows.
_MOST_GEOMETRIES = 40


@options.with_options(tree=options.list_tree_options(TreeOptions, without=("cache", "cache_dir")))
def stats(
    source: options.Source,
    /,
    *,
    exact: bool = False,
    rays: bool = False,
    validate: bool = False,
    device: options.Device = None,
    plot: Annotated[Path | None, Parameter(metavar="FILE.png")] = None,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Build a tree and measure it.

    Parameters
    ----------
    exact
        Measure the end-point overlap on all triangles, not on at most 200,000.
    rays
        Count node steps and triangle tests per ray.
    validate
        Check the tree.
    plot
        Draw the histograms of leaf sizes and depths.
    """
    from ..builders.build import leaf_limit
    from ..builders.options import FAST_QUALITY
    from ..builders.tree_cache import get_trees
    from ..bvh import validate_tree
    from ..device.select import choose_device
    from ..errors import ConfigError
    from ..files.open_scene import open_scene
    from ..geometry import Mesh
    from ..rendering.scene_stats import measure_scene
    from ..stats import measure_tree
    from ..stats.tree_plot import check_plot_path, write_tree_plot
    from ..stats.tree_stats import OVERLAP_SAMPLE
    from ..structs import MAX_DEPTH
    from ..support.stopwatch import Stopwatch, add_total

    # All input is checked before any work.
    if plot is not None:
        check_plot_path(plot)
    wanted = options.make_options(TreeOptions, tree)
    is_fast = wanted.build.quality == FAST_QUALITY
    if device is not None and not (is_fast or rays):
        raise ConfigError("--device needs --quality fast, which it builds, or --rays, which it casts")
    info = None if device is None else choose_device(device)
    watch = Stopwatch()
    scene, view = open_scene(source)
    state = scene.snapshot()
    watch.lap("load")
    mesh = state.lone_shape if isinstance(state.lone_shape, Mesh) else None
    for option, is_given in {"--exact": exact, "--rays": rays, "--plot": plot is not None}.items():
        if is_given and mesh is None:
            raise ConfigError(f"{option} measures the tree of one mesh, and {source} has several objects")

    made = get_trees(state.shapes if mesh is None else [mesh], lambda _: wanted, info)
    watch.lap("build")
    if validate:
        for bvh in made.bvhs:
            validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_limit(wanted.builder, wanted.build))
        watch.lap("validate")
    trees, cost = made.bvhs, wanted.build.traversal_cost
    report: dict[str, Any]
    if mesh is None:
        report = {"scene": measure_scene(state, trees, traversal_cost=cost)}
    else:
        measured = measure_tree(trees[0], traversal_cost=cost, overlap_sample=None if exact else OVERLAP_SAMPLE)
        facts = {
            "name": mesh.name,
            "vertices": len(mesh.vertices),
            "triangles": mesh.face_count,
            "degenerate_triangles": mesh.degenerate_count,
            "size": (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).tolist(),
            "centre": mesh.origin.tolist(),
            "bytes": mesh.vertices.nbytes + mesh.local_vertices.nbytes + mesh.faces.nbytes,
        }
        report = {"mesh": facts, "tree": measured.as_dict()}
    watch.lap("measure")
    if rays:
        report["rays"] = _measure_rays(trees[0], view, info)
        watch.lap("rays")
    report["build"] = {
        "builder": wanted.builder,
        **asdict(wanted.build),
        "workers": made.workers,
        "device": (info or choose_device()).name if is_fast else None,
        "validated": validate,
        "timings_ms": add_total(watch.laps_ms, watch.total_ms),
        **({} if mesh is None else {"phases_ms": dict(trees[0].timings_ms)}),
    }
    if plot is not None and mesh is not None:
        write_tree_plot(plot, measured, f"{mesh.name}, builder {wanted.builder}")
    shown = _show_scene(report) if mesh is None else _show_mesh(report)
    print_report(report, *shown, _make_times(report["build"]), as_json=as_json)


def _measure_rays(bvh: Bvh, view: View, device: DeviceInfo | None) -> dict[str, dict[str, float]]:
    """Return the mean counts per ray, for each kind of rays."""
    from ..rendering.heat_map import mean_steps, measure_rays
    from ..views.cameras.bounds import SceneBounds
    from ..views.view_finder import ViewFinder

    finder = ViewFinder(SceneBounds.of_mesh(bvh.mesh))
    steps = measure_rays(bvh, finder.camera(finder.complete(view)), view.width / view.height, device=device)
    return {
        kind: {
            "rays": len(counted),
            "hit": float((counted["prim_id"] >= 0).mean()) if len(counted) else 0.0,
            **mean_steps(counted),
        }
        for kind, counted in steps.items()
    }


def _show_mesh(report: dict[str, Any]) -> Iterator[Any]:
    """Yield the table of a mesh and its tree, and the histograms."""
    mesh, tree, costs = report["mesh"], report["tree"], report.get("rays", {})
    degenerate = f"{mesh['degenerate_triangles']:,} degenerate" if mesh["degenerate_triangles"] else ""
    is_sampled = tree["epo_triangles"] < tree["triangle_count"]
    yield make_facts({
        "mesh": join_facts(
            mesh["name"], describe_count(mesh["triangles"], "triangle"), f"{mesh['vertices']:,} vertices", degenerate
        ),
        "size": _format_size(mesh["size"]),
        "centre": ", ".join(f"{coordinate:.9g}" for coordinate in mesh["centre"]),
        "built by": _describe_builder(report),
        "nodes": f"{tree['node_count']:,}: {tree['interior_count']:,} interior, {tree['leaf_count']:,} leaves",
        "depth": f"{tree['depth']}; mean depth of a leaf {tree['mean_leaf_depth']:.2f}",
        "SAH cost": f"{tree['sah_cost']:.3f}, with a traversal cost of {tree['traversal_cost']:g}",
        "EPO": join_facts(
            f"{tree['epo']:.3f}", f"on a sample of {tree['epo_triangles']:,} triangles" if is_sampled else ""
        ),
        "on the host": _format_bytes(tree["host_bytes"], tree["triangle_count"]),
        **{
            f"as {layout}": f"{_format_bytes(size, tree['triangle_count'])}, triangles included"
            for layout, size in tree["device_bytes"].items()
        },
        **{
            f"{kind} rays": f"{cost['tests']:.2f} tests: {cost['node_steps']:.2f} node steps, "
            f"{cost['triangle_tests']:.2f} triangles; {100 * cost['hit']:.1f} % of {cost['rays']:,} hit"
            for kind, cost in costs.items()
        },
    })  # fmt: skip
    yield _make_histogram("triangles", tree["leaf_sizes"], tree["leaf_count"])
    yield _make_histogram("depth", tree["leaf_depths"], tree["leaf_count"])


def _make_histogram(heading: str, counts: tuple[int, ...], total: int) -> Any:
    """Return a table of bars."""
    from rich.console import Console

    from ..stats.tree_stats import gather_bars

    bars = gather_bars(counts, _MOST_ROWS)
    highest = max(bar.count for bar in bars)
    sign = "█" if Console().encoding.startswith("utf") else "#"
    rows = (
        # A bar that is not empty has at least one cell.
        (
            bar.label,
            f"{bar.count:,}",
            f"{100 * bar.count / total:.1f} %",
            sign * max(round(_BAR_CELLS * bar.count / highest), bar.count > 0),
        )
        for bar in bars
    )
    return make_table((heading, "leaves", "", ""), rows, numbers=(heading, "leaves"))


def _show_scene(report: dict[str, Any]) -> Iterator[Any]:
    """Yield the tables of a scene, of its geometries, and of the tree over the instances."""
    from rich.markup import escape

    scene = report["scene"]
    top, geometries = scene["instances"], scene["geometries"]
    largest = sorted(geometries, key=lambda geometry: -geometry["prim_count"])[:_MOST_GEOMETRIES]
    is_cut = len(geometries) > _MOST_GEOMETRIES
    sides = (upper - lower for lower, upper in zip(scene["lower"], scene["upper"], strict=True))
    yield make_facts({
        "scene": describe_scene(top["instance_count"], len(geometries), scene["prim_count"]),
        "size": _format_size(sides),
        "built by": _describe_builder(report),
        **{f"as {layout}": f"{_format_mib(size)}, both levels" for layout, size in scene["device_bytes"].items()},
        "below": f"the {_MOST_GEOMETRIES} largest geometries; --json has all of them" if is_cut else "",
    })  # fmt: skip
    numbers = "primitives", "instances", "nodes", "depth", "SAH cost", "as bvh2"
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
    yield make_table(("geometry", *numbers), rows, numbers=numbers)
    yield make_facts({
        "instances": f"{top['instance_count']:,}, in a tree of {top['node_count']:,} nodes",
        "depth": f"{top['depth']}",
        "SAH cost": f"{top['sah_cost']:.3f}, where entering an instance costs 1",
        "on the device": f"{top['device_bytes'] / _MIB:,.2f} MiB, "
        f"{top['device_bytes_per_instance']:.1f} bytes an instance",
    })  # fmt: skip


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


def _describe_builder(report: dict[str, Any]) -> str:
    from ..builders.options import DEFAULT_QUALITY

    build = report["build"]
    return join_facts(
        build["builder"],
        "" if build["quality"] == DEFAULT_QUALITY else f"quality {build['quality']}",
        build["device"] or describe_workers(build["workers"]),
        "validated" if build["validated"] else "",
    )


def _format_mib(size: int) -> str:
    return f"{size / _MIB:,.1f} MiB"


def _format_bytes(size: int, triangle_count: int) -> str:
    return f"{_format_mib(size)}, {size / triangle_count:.1f} bytes per triangle"


def _format_size(sides: Iterable[float]) -> str:
    return " x ".join(f"{side:.6g}" for side in sides)

"""`clbvh stats`: the parts of a mesh's tree, measures of its quality, and the time of each phase.

A scene of several objects has trees in two levels, which the second half of this file shows.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options
from .tables import (
    add_time,
    choose_sign,
    describe_count,
    describe_mesh,
    describe_options,
    describe_scene,
    describe_workers,
    make_facts,
    make_table,
    make_times,
    print_tables,
)

if TYPE_CHECKING:
    from ..builders.tree_cache import TreeOptions
    from ..bvh import Bvh
    from ..geometry import Mesh
    from ..rendering.scene import Scene
    from ..rendering.scene_stats import SceneStats
    from ..stats import TreeStats
    from ..support.stopwatch import Stopwatch

_MIB = 1 << 20

# Size of the histograms in the terminal.
_MOST_ROWS = 16
_BAR_CELLS = 40

# Most geometries of a scene that the table shows.
_MOST_GEOMETRIES = 40


def stats(
    source: options.Source,
    builder: options.Builder = options.DEFAULT_BUILDER,
    workers: options.Workers = None,
    bins: options.Bins = None,
    leaf_size: options.LeafSize = options.DEFAULT_LEAF_SIZE,
    traversal_cost: options.TraversalCost = options.DEFAULT_TRAVERSAL_COST,
    task_threshold: options.TaskThreshold = None,
    frontier: options.Frontier = options.DEFAULT_FRONTIER,
    quality: options.Quality = options.DEFAULT_QUALITY,
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Measure the end-point overlap on all triangles, not on at most 200,000."),
    ] = False,
    rays: Annotated[bool, typer.Option("--rays", help="Count node steps and triangle tests per ray.")] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw the histograms of leaf sizes and depths.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Build a tree and measure it."""
    from ..builders.options import BuildOptions
    from ..builders.tree_cache import TreeOptions, get_tree
    from ..errors import ConfigError
    from ..rendering.open_scene import open_scene
    from ..stats import measure_tree
    from ..stats.tree_plot import check_plot_path, write_tree_plot
    from ..stats.tree_stats import OVERLAP_SAMPLE
    from ..support.stopwatch import Stopwatch, add_total

    # All input is checked before any work.
    if plot is not None:
        check_plot_path(plot)
    watch = Stopwatch()
    scene = open_scene(source)
    wanted = TreeOptions(
        builder=builder,
        workers=workers,
        build=BuildOptions(bins, leaf_size, traversal_cost, task_threshold, frontier, quality),
    )
    if scene.mesh is None:
        for option, is_given in {"--exact": exact, "--rays": rays, "--plot": plot is not None}.items():
            if is_given:
                raise ConfigError(f"{option} measures the tree of one mesh, and {source} has several objects")
        _show_scene_stats(scene, wanted, watch, traversal_cost, as_json=as_json)
        return

    watch = Stopwatch()
    mesh = scene.transform.apply(scene.only_mesh().load())
    watch.lap("load")
    made = get_tree(mesh, wanted)
    watch.lap("build")
    measured = measure_tree(made.bvh, traversal_cost=traversal_cost, overlap_sample=None if exact else OVERLAP_SAMPLE)
    watch.lap("measure")
    ray_costs = _measure_rays(made.bvh, scene) if rays else None
    watch.lap("rays")
    phases_ms = {
        "load": watch.laps_ms["load"],
        "build": made.timings_ms["build"],
        "measure": watch.laps_ms["measure"],
        **({"rays": watch.laps_ms["rays"]} if rays else {}),
    }
    timings_ms = add_total(phases_ms, watch.total_ms)
    if plot is not None:
        write_tree_plot(plot, measured, f"{mesh.name}, builder {builder}")

    report = {
        "mesh": {
            "name": mesh.name,
            "vertices": len(mesh.vertices),
            "triangles": mesh.face_count,
            "degenerate_triangles": mesh.degenerate_count,
            "size": (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).tolist(),
            "centre": mesh.origin.tolist(),
            "bytes": mesh.vertices.nbytes + mesh.local_vertices.nbytes + mesh.faces.nbytes,
        },
        "build": {
            **describe_options(wanted),
            "workers": made.workers,
            "timings_ms": timings_ms,
            "phases_ms": dict(made.bvh.timings_ms),
        },
        "tree": measured.as_dict(),
        **({"rays": ray_costs} if rays else {}),
    }
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print_report(report, measured)


def _measure_rays(bvh: Bvh, scene: Scene) -> dict[str, dict[str, float]]:
    """Return the mean counts per ray, for each kind of rays."""
    from ..rendering.heat_map import measure_rays

    visits = measure_rays(bvh, scene.camera(bvh.mesh), scene.width / scene.height)
    return {
        kind: {
            "rays": len(visited.prim_id),
            "hit": float((visited.prim_id >= 0).mean()) if len(visited.prim_id) else 0.0,
            "node_steps": visited.node_steps_per_ray,
            "leaf_visits": visited.leaf_visits_per_ray,
            "triangle_tests": visited.triangle_tests_per_ray,
            "tests": visited.tests_per_ray,
        }
        for kind, visited in visits.items()
    }


def _print_report(report: dict[str, Any], measured: TreeStats) -> None:
    mesh, build = report["mesh"], report["build"]
    facts = make_facts()
    degenerate = mesh["degenerate_triangles"]
    facts.add_row(
        "mesh",
        describe_mesh(
            mesh["name"],
            describe_count(mesh["triangles"], "triangle"),
            f"{mesh['vertices']:,} vertices",
            f"{degenerate:,} degenerate" if degenerate else "",
        ),
    )
    facts.add_row("size", " x ".join(f"{length:.6g}" for length in mesh["size"]))
    facts.add_row("centre", ", ".join(f"{coordinate:.9g}" for coordinate in mesh["centre"]))
    facts.add_row(
        "nodes",
        f"{measured.node_count:,}: {measured.interior_count:,} interior, {measured.leaf_count:,} leaves",
    )
    facts.add_row("depth", f"{measured.depth}; mean depth of a leaf {measured.mean_leaf_depth:.2f}")
    facts.add_row("SAH cost", f"{measured.sah_cost:.3f}, with a traversal cost of {measured.traversal_cost:g}")
    sampled = measured.epo_triangles < measured.triangle_count
    facts.add_row(
        "EPO", f"{measured.epo:.3f}" + (f", on a sample of {measured.epo_triangles:,} triangles" if sampled else "")
    )
    facts.add_row("on the host", _format_bytes(measured.host_bytes, measured.host_bytes_per_triangle))
    for layout, size in measured.device_bytes.items():
        per_triangle = measured.device_bytes_per_triangle[layout]
        facts.add_row(f"as {layout}", f"{_format_bytes(size, per_triangle)}, triangles included")

    for kind, cost in report.get("rays", {}).items():
        facts.add_row(
            f"{kind} rays",
            f"{cost['tests']:.2f} tests: {cost['node_steps']:.2f} node steps, {cost['triangle_tests']:.2f} triangles; "
            f"{100 * cost['hit']:.1f} % of {cost['rays']:,} hit",
        )

    sizes = _make_histogram("triangles", measured.leaf_sizes, measured.leaf_count)
    depths = _make_histogram("depth", measured.leaf_depths, measured.leaf_count)
    print_tables(facts, sizes, depths, _make_time_table(build))


def _make_time_table(build: dict[str, Any]) -> Any:
    """Return the table of all phases; those of the build are indented, and add up to it."""
    from ..support.stopwatch import add_total

    descriptions = {
        "load": "load the mesh, find its local coordinates",
        "build": f"builder {build['builder']}, {describe_workers(build['workers'])}; of this:",
        "measure": "the measures above",
        "rays": "cast on the host, step for step as layout bvh2",
        "other": "between the phases",
        "total": "wall time",
    }
    times = make_times()
    for phase, ms in build["timings_ms"].items():
        add_time(times, phase, ms, descriptions[phase], style="bold" if phase == "total" else "")
        if phase == "build":
            parts_ms = add_total(build["phases_ms"], ms)
            del parts_ms["total"]
            for part, part_ms in parts_ms.items():
                add_time(times, f"  {part}", part_ms, "")
    return times


def _make_histogram(heading: str, counts: tuple[int, ...], total: int) -> Any:
    """Return a table of bars."""
    from ..stats.tree_stats import gather_bars

    table = make_table(heading, "leaves", "", "", numbers=(heading, "leaves"))
    bars = gather_bars(counts, _MOST_ROWS)
    highest = max(bar.count for bar in bars)
    full = choose_sign("█", "#")
    for bar in bars:
        # A bar that is not empty has at least one cell.
        cells = max(round(_BAR_CELLS * bar.count / highest), bar.count > 0)
        table.add_row(bar.label, f"{bar.count:,}", f"{100 * bar.count / total:.1f} %", full * cells)
    return table


def _format_bytes(size: int, per_triangle: float) -> str:
    return f"{size / _MIB:,.1f} MiB, {per_triangle:.1f} bytes per triangle"


_SCENE_PHASES = {
    "load": "load and place the objects",
    "build": "build the trees of both levels",
    "measure": "the measures above",
    "other": "between the phases",
    "total": "wall time",
}


def _show_scene_stats(
    scene: Scene, wanted: TreeOptions, watch: Stopwatch, traversal_cost: float, *, as_json: bool
) -> None:
    """Build the trees of a scene, and print their measures; the watch was started before the scene was loaded."""
    from ..builders.tree_cache import get_tree
    from ..rendering.scene_stats import measure_scene
    from ..support.stopwatch import add_total

    state = scene.snapshot()
    watch.lap("load")
    workers = 1

    def build_tree(mesh: Mesh) -> Bvh:
        nonlocal workers
        watch.lap("measure")
        made = get_tree(mesh, wanted)
        watch.lap("build")
        workers = max(workers, made.workers)
        return made.bvh

    measured = measure_scene(state, build_tree, traversal_cost=traversal_cost)
    watch.lap("measure")
    phases_ms = {phase: watch.laps_ms[phase] for phase in ("load", "build", "measure")}
    report = {
        "scene": measured.as_dict(),
        "build": {
            **describe_options(wanted),
            "workers": workers,
            "timings_ms": add_total(phases_ms, watch.total_ms),
        },
    }
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print_scene_report(measured, report["build"])


def _print_scene_report(measured: SceneStats, build: dict[str, Any]) -> None:
    top = measured.top
    facts = make_facts()
    facts.add_row("scene", describe_scene(top.instance_count, len(measured.geometries), measured.prim_count))
    sides = (upper - lower for lower, upper in zip(measured.lower, measured.upper, strict=True))
    facts.add_row("size", " x ".join(f"{side:.6g}" for side in sides))
    facts.add_row("built by", f"{build['builder']}, {describe_workers(build['workers'])}")
    for layout, size in measured.device_bytes.items():
        facts.add_row(f"as {layout}", f"{size / _MIB:,.1f} MiB, both levels")

    if len(measured.geometries) > _MOST_GEOMETRIES:
        facts.add_row("below", f"the {_MOST_GEOMETRIES} largest geometries; --json has all of them")

    top_facts = make_facts()
    top_facts.add_row("instances", f"{top.instance_count:,}, in a tree of {top.node_count:,} nodes")
    top_facts.add_row("depth", f"{top.depth}")
    top_facts.add_row("SAH cost", f"{top.sah_cost:.3f}, where entering an instance costs 1")
    top_facts.add_row(
        "on the device", f"{top.device_bytes / _MIB:,.2f} MiB, {top.device_bytes_per_instance:.1f} bytes an instance"
    )

    times = make_times()
    for phase, description in _SCENE_PHASES.items():
        ms = build["timings_ms"][phase]
        add_time(times, phase, ms, description, style="bold" if phase == "total" else "")
    print_tables(facts, _make_geometry_table(measured), top_facts, times)


def _make_geometry_table(measured: SceneStats) -> Any:
    """Return one row for each geometry; in a scene of very many, for each of the largest ones."""
    from rich.markup import escape

    numbers = "primitives", "instances", "nodes", "depth", "SAH cost", "as bvh2"
    table = make_table("geometry", *numbers, numbers=numbers)
    shown = measured.geometries
    if len(shown) > _MOST_GEOMETRIES:
        largest = sorted(range(len(shown)), key=lambda index: -shown[index].prim_count)[:_MOST_GEOMETRIES]
        shown = tuple(shown[index] for index in sorted(largest))
    for geometry in shown:
        table.add_row(
            escape(geometry.name),
            f"{geometry.prim_count:,} {geometry.kind}",
            f"{geometry.instance_count:,}",
            f"{geometry.node_count:,}",
            f"{geometry.depth}",
            f"{geometry.sah_cost:.3f}",
            f"{geometry.device_bytes['bvh2'] / _MIB:,.2f} MiB",
        )
    return table

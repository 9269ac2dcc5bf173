"""`clbvh stats`: the parts of a mesh's tree, measures of its quality, and the time of each phase.

A scene of several objects has trees in two levels: `scene_stats.py` shows them.
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
    describe_workers,
    make_facts,
    make_times,
    print_tables,
)

if TYPE_CHECKING:
    from ..bvh import Bvh
    from ..rendering.scene import Scene
    from ..stats import TreeStats

_MIB = 1 << 20

# Size of the histograms in the terminal.
_MOST_ROWS = 16
_BAR_CELLS = 40


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
    from ..builders.tree_cache import TreeOptions, get_tree
    from ..errors import ConfigError
    from ..rendering.open_scene import open_scene
    from ..stats import measure_tree
    from ..stats.tree_plot import check_plot_path, write_tree_plot
    from ..stats.tree_stats import OVERLAP_SAMPLE
    from ..support.stopwatch import Stopwatch, add_total
    from .scene_stats import show_scene_stats

    # All input is checked before any work.
    if plot is not None:
        check_plot_path(plot)
    watch = Stopwatch()
    scene = open_scene(source)
    wanted = TreeOptions(
        builder=builder,
        workers=workers,
        build=options.make_build_options(bins, leaf_size, traversal_cost, task_threshold, frontier, quality),
    )
    if scene.mesh is None:
        for option, is_given in {"--exact": exact, "--rays": rays, "--plot": plot is not None}.items():
            if is_given:
                raise ConfigError(f"{option} measures the tree of one mesh, and {source} has several objects")
        show_scene_stats(scene, wanted, watch, traversal_cost, as_json=as_json)
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
    from rich.table import Table

    from ..stats.histogram import gather_bars

    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column(heading, justify="right")
    table.add_column("leaves", justify="right")
    table.add_column("")
    table.add_column("")
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

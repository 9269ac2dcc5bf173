"""`clbvh stats` of a scene: the tree of each geometry, and the tree over the instances."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from .tables import add_time, describe_options, describe_workers, make_facts, make_times, print_tables

if TYPE_CHECKING:
    from ..builders.tree_cache import TreeOptions
    from ..bvh import Bvh
    from ..geometry import Mesh
    from ..rendering.scene import Scene
    from ..rendering.scene_stats import SceneStats
    from ..support.stopwatch import Stopwatch

_MIB = 1 << 20

# Most geometries that the table shows.
_MOST_ROWS = 40

_PHASES = {
    "load": "load and place the objects",
    "build": "build the trees of both levels",
    "measure": "the measures above",
    "other": "between the phases",
    "total": "wall time",
}


def show_scene_stats(
    scene: Scene, wanted: TreeOptions, watch: Stopwatch, traversal_cost: float, *, as_json: bool
) -> None:
    """Build the trees of a scene, and print their measures as tables or as one JSON object.

    Parameters
    ----------
    scene : Scene
    wanted : TreeOptions
    watch : Stopwatch
        Started before the scene was loaded.
    traversal_cost : float
        Of an interior node, in primitive tests.
    as_json : bool
    """
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
        _print_report(measured, report["build"])


def _print_report(measured: SceneStats, build: dict[str, Any]) -> None:
    top = measured.top
    facts = make_facts()
    facts.add_row(
        "scene",
        f"{top.instance_count:,} instance{'s' * (top.instance_count > 1)} of "
        f"{len(measured.geometries):,} geometr{'ies' if len(measured.geometries) > 1 else 'y'}, "
        f"{measured.prim_count:,} primitives placed",
    )
    sides = (upper - lower for lower, upper in zip(measured.lower, measured.upper, strict=True))
    facts.add_row("size", " x ".join(f"{side:.6g}" for side in sides))
    facts.add_row("built by", f"{build['builder']}, {describe_workers(build['workers'])}")
    for layout, size in measured.device_bytes.items():
        facts.add_row(f"as {layout}", f"{size / _MIB:,.1f} MiB, both levels")

    if len(measured.geometries) > _MOST_ROWS:
        facts.add_row("below", f"the {_MOST_ROWS} largest geometries; --json has all of them")

    times = make_times()
    for phase, description in _PHASES.items():
        ms = build["timings_ms"][phase]
        add_time(times, phase, ms, description, style="bold" if phase == "total" else "")
    print_tables(facts, _make_geometry_table(measured), _make_top_facts(measured), times)


def _make_geometry_table(measured: SceneStats) -> Any:
    """Return one row for each geometry; in a scene of very many, for each of the largest ones."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("geometry")
    for heading in ("primitives", "instances", "nodes", "depth", "SAH cost", "as bvh2"):
        table.add_column(heading, justify="right")
    shown = measured.geometries
    if len(shown) > _MOST_ROWS:
        largest = sorted(range(len(shown)), key=lambda index: -shown[index].prim_count)[:_MOST_ROWS]
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


def _make_top_facts(measured: SceneStats) -> Any:
    top = measured.top
    facts = make_facts()
    facts.add_row("instances", f"{top.instance_count:,}, in a tree of {top.node_count:,} nodes")
    facts.add_row("depth", f"{top.depth}")
    facts.add_row("SAH cost", f"{top.sah_cost:.3f}, where entering an instance costs 1")
    facts.add_row(
        "on the device", f"{top.device_bytes / _MIB:,.2f} MiB, {top.device_bytes_per_instance:.1f} bytes an instance"
    )
    return facts

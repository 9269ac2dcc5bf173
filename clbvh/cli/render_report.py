"""The tables of `clbvh render`: what was drawn, and the time of each phase."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .tables import add_time, describe_count, describe_mesh, describe_workers, make_facts, make_times, print_tables

if TYPE_CHECKING:
    from ..rendering.picture import Picture

# The rows of the time table, in the order of the work.
_PHASES = {
    "load": "load the mesh, find its local coordinates",
    "cache": "look the tree up in the cache, or keep it there",
    "build": "build the tree",
    "open": "open the device",
    "layout": "arrange the tree for the device",
    "compile": "compile kernels in a first run, or load them",
    "upload": "host to device, by the device's clock",
    "kernel": "trace and shade, by the device's clock",
    "download": "device to host, by the device's clock",
    "other": "launches, and whatever lies between the phases",
    "total": "wall time",
    "write": "write the picture or heat map, not in the total",
}


def print_render_report(report: dict[str, Any], picture: Picture) -> None:
    """Print the tables of a picture.

    Parameters
    ----------
    report : dict
        `Picture.report`, with the time of writing.
    picture : Picture
    """
    from rich.markup import escape

    facts = make_facts()
    nodes = describe_count(report["nodes"], "node")
    made_by = "from the cache" if report["tree_from_cache"] else describe_workers(report["workers"])
    if picture.objects is not None:
        facts.add_row("scene", _describe_counts(report))
        spheres = describe_count(report["spheres"], "sphere") if report["spheres"] else ""
        facts.add_row("geometry", ", ".join(filter(None, (*_describe_triangles(report), spheres))))
        facts.add_row("trees", f"{nodes}, depth {report['depth']} of both levels, {made_by}")
    else:
        facts.add_row("mesh", describe_mesh(report["mesh"], *_describe_triangles(report)))
    if picture.bvh is not None:
        facts.add_row(
            "tree",
            f"{nodes}, depth {report['depth']}, SAH cost {report['sah_cost']:.2f}, {made_by}",
        )
    facts.add_row("device", f"{escape(report['device'])}, layout {report['layout']}")
    facts.add_row(
        "picture",
        f"{report['width']} x {report['height']}, {report['hits']:,} of {report['rays']:,} rays hit, "
        f"{report['mrays_per_s']:.2f} Mray/s",
    )
    if report["validated_pixels"]:
        trees = "tree" if picture.objects is None else "all trees"
        facts.add_row("validated", f"{trees} and {report['validated_pixels']:,} pixels agree with the reference")

    times = make_times()
    for phase, description in _PHASES.items():
        ms = report["timings_ms"][phase]
        if phase == "load" and picture.objects is not None:
            description = "load and place the objects"
        if phase != "cache" or ms:
            add_time(times, phase, ms, description, style="bold" if phase == "total" else "")
    print_tables(facts, times)


def _describe_triangles(report: dict[str, Any]) -> tuple[str, ...]:
    degenerate = report["degenerate_triangles"]
    return (
        describe_count(report["triangles"], "triangle") if report["triangles"] else "",
        f"{degenerate:,} of them degenerate: never hit" if degenerate else "",
    )


def _describe_counts(report: dict[str, Any]) -> str:
    instances, geometries = report["instances"], report["geometries"]
    return (
        f"{instances:,} instance{'s' * (instances > 1)} of {geometries:,} geometr{'ies' if geometries > 1 else 'y'}, "
        f"{report['placed_primitives']:,} primitives placed"
    )

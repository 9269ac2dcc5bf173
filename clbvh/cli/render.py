"""`clbvh render`: a picture of meshes or of a scene, and a table of the time of each phase."""

from __future__ import annotations

import threading
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .signals import calling_on_interrupt
from .tables import (
    describe_count,
    describe_scene,
    join_facts,
    make_facts,
    make_times,
    print_json,
    print_notes,
    print_tables,
)

if TYPE_CHECKING:
    from ..rendering.picture import Picture

_HITS_HELP = "Write t, u, v, prim_id, geometry_id and instance_id of every pixel, each (H, W), and the names."
_HEATMAP_HELP = "Show the node steps of each ray instead, or its primitive tests, with a colour bar below."
_TIME_HELP = "Take as many samples as this time allows; one at least."
_KEEP_HELP = "On Ctrl-C, write the picture of the samples so far."

# The rows of the time table, in the order of the work.
_PHASES = {
    "load": "load and place the objects",
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


@options.with_options(changes=options.list_view_options(), tree=options.list_tree_options())
def render(
    *sources: options.Sources,
    output: options.Outputs,
    hits: Annotated[Path | None, Parameter(metavar="FILE.npz", help=_HITS_HELP)] = None,
    heatmap: Annotated[str | None, Parameter(metavar="nodes|triangles", help=_HEATMAP_HELP)] = None,
    time_limit_s: Annotated[float | None, Parameter(name="--time", metavar="SECONDS", help=_TIME_HELP)] = None,
    keep: Annotated[bool, Parameter(help=_KEEP_HELP)] = False,
    changes: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Render meshes or a scene."""
    from ..errors import ConfigError
    from ..rendering.image_files import check_has_alpha, check_hits_path, check_picture_path
    from ..rendering.render import render as draw

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    if hits is not None:
        check_hits_path(hits)
    wanted = options.make_options(RenderOptions, tree)
    if heatmap is not None:
        from ..rendering.heat_map import check_quantity

        check_quantity(heatmap)
        if wanted.builder == "brute":
            raise ConfigError(
                "a heat map shows the steps through a tree, and the builder brute has none: take another one"
            )
    if changes.get("transparent") and heatmap is None:
        for path in output:
            check_has_alpha(path)
    stopped = threading.Event()
    with Progress() as progress, calling_on_interrupt(stopped.set) if keep else nullcontext():
        picture = draw(
            list(sources), None, wanted, time_limit_s=time_limit_s, on_samples=progress.show_samples(time_limit_s),
            is_stopped=stopped.is_set, on_phase=progress.enter, **options.read_changes(changes),
        )  # fmt: skip
    report = picture.report()
    report["timings_ms"]["write"] = _write(picture, output, hits, heatmap)
    if as_json:
        print_json(report)
    else:
        _print_report(report)
    print_notes(picture.notes)
    if not report["hits"]:
        print_notes(["no ray hits anything: the picture shows the background only"])


def _write(picture: Picture, output: list[Path], hits: Path | None, heatmap: str | None) -> float:
    """Write all files and return the time in milliseconds."""
    from ..rendering.image_files import write_hits, write_picture

    begin = time.perf_counter()
    pixels = picture.pixels
    if heatmap is not None:
        from ..rendering.heat_map import draw_heat_map_of

        pixels = draw_heat_map_of(picture.world, picture.camera, pixels.shape[1], pixels.shape[0], heatmap)
    for path in output:
        write_picture(path, pixels)
    if hits is not None:
        state = picture.world.state
        write_hits(hits, picture.hits, state.names, state.instance_names)
    return (time.perf_counter() - begin) * 1e3


def _print_report(report: dict[str, Any]) -> None:
    """Print the tables of a picture: what was drawn, and the time of each phase."""
    degenerate, validated, sah_cost = report["degenerate_triangles"], report["validated_pixels"], report["sah_cost"]
    counts = (
        describe_count(report["triangles"], "triangle") if report["triangles"] else "",
        f"{degenerate:,} of them degenerate: never hit" if degenerate else "",
        describe_count(report["spheres"], "sphere") if report.get("spheres") else "",
    )
    trees = join_facts(
        describe_count(report["nodes"], "node"),
        f"depth {report['depth']}",
        f"SAH cost {sah_cost:.2f}" if sah_cost is not None else "",
        "from the cache" if report["tree_from_cache"] else describe_count(report["workers"], "worker"),
    )
    has_objects = "instances" in report
    if has_objects:
        scene = describe_scene(report["instances"], report["geometries"], report["placed_primitives"])
        objects = {"scene": scene, "geometry": join_facts(*counts), "trees": trees}
    else:
        objects = {"mesh": join_facts(report["mesh"], *counts), "tree": trees if report["nodes"] else ""}
    facts = {
        **objects,
        "device": f"{report['device']}, layout {report['layout']}",
        "picture": f"{report['width']} x {report['height']}, {report['hits']:,} of {report['rays']:,} rays hit, "
        f"{report['mrays_per_s']:.2f} Mray/s",
        "validated": f"{'all trees' if has_objects else 'tree'} and {validated:,} pixels agree with the reference"
        if validated
        else "",
    }
    timings_ms = report["timings_ms"]
    rows = [
        (phase, timings_ms[phase], text) for phase, text in _PHASES.items() if phase != "cache" or timings_ms[phase]
    ]
    print_tables(make_facts(facts), make_times(rows))

"""`clbvh render`: a picture of meshes or of a scene, and a table of the time of each phase."""

from __future__ import annotations

import os
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
from .tables import describe_count, describe_scene, describe_workers, join_facts, make_facts, make_times, print_report

if TYPE_CHECKING:
    from ..rendering.picture import Picture

# The field of /proc/self/stat, behind the name of the program, with the ticks from the boot to the process's begin.
_STARTTIME = 19


@options.with_options(view=options.list_view_options(), tree=options.list_tree_options())
def render(
    *sources: options.Sources,
    output: options.Outputs,
    hits: Annotated[Path | None, Parameter(metavar="FILE.npz")] = None,
    heatmap: Annotated[str | None, Parameter(metavar="nodes|triangles")] = None,
    time_limit_s: Annotated[float | None, Parameter(name="--time", metavar="SECONDS")] = None,
    keep: bool = False,
    point_radius: options.PointRadius = None,
    view: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Render meshes or a scene.

    Parameters
    ----------
    hits
        Write t, u, v, prim_id, geometry_id and instance_id of every pixel, each (H, W), and the names.
    heatmap
        Show the node steps of each ray instead, or its primitive tests, with a colour bar below.
    time_limit_s
        Take as many samples as this time allows; one at least.
    keep
        On Ctrl-C, write the picture of the samples so far.
    """
    from ..errors import ConfigError
    from ..files.image_files import check_has_alpha, check_picture_path
    from ..rendering.renderer import render as draw
    from ..trace.hits.hit_files import check_hits_path

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
        if heatmap is None and path.suffix.lower() != ".png" and _is_transparent(sources, view):
            check_has_alpha(path)
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
    stopped, start_ms = threading.Event(), _ms_so_far()
    with Progress() as progress, calling_on_interrupt(stopped.set) if keep else nullcontext():
        picture = draw(
            options.find_source(sources, point_radius), None, wanted, time_limit_s=time_limit_s,
            on_samples=progress.show_samples(time_limit_s),
            is_stopped=stopped.is_set, on_phase=progress.enter, **options.read_changes(view),
        )  # fmt: skip
    report = picture.report()
    write_ms = _write(picture, output, hits, heatmap)
    report["timings_ms"] = _complete_times(report["timings_ms"], start_ms, write_ms)
    # The cache has a row where it was used.
    times = (row for row in report["timings_ms"].items() if row[0] != "cache" or row[1])
    empty = () if report["hits"] else ("no ray hits anything: the picture shows the background only",)
    print_report(report, _make_facts(report), make_times(times), as_json=as_json, notes=(*picture.notes, *empty))


def _is_transparent(sources: tuple[str, ...], view: options.Given) -> bool:
    """Return whether the options, or else the scene file, leave the background out."""
    from ..files.open_scene import find_scene_file

    if "transparent" in view or len(sources) > 1 or (file := find_scene_file(sources[0])) is None:
        return view.get("transparent", False)
    from ..files.scene_file import parse_scene_file

    return parse_scene_file(file).view.transparent


def _ms_so_far() -> float:
    """Return the milliseconds since this process began."""
    try:
        # psutil adds the time of the boot, which it knows by the second.
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[_STARTTIME])
        return (time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")) * 1e3
    except (OSError, AttributeError):  # another system than Linux
        import psutil  # no help needs it

        return (time.time() - psutil.Process().create_time()) * 1e3


def _complete_times(timings_ms: dict[str, float], start_ms: float, write_ms: float) -> dict[str, float]:
    """Return the phases of the whole command, which add up to what the user has waited."""
    phases = {"start": start_ms, **timings_ms, "write": write_ms}
    del phases["other"], phases["total"]
    # The clock of a process's begin has steps of 10 ms.
    total = max(_ms_so_far(), sum(phases.values()))
    return phases | {"other": total - sum(phases.values()), "total": total}


def _write(picture: Picture, output: list[Path], hits: Path | None, heatmap: str | None) -> float:
    """Write all files and return the time in milliseconds."""
    from ..files.image_files import write_picture
    from ..trace.hits.hit_files import write_hits

    begin = time.perf_counter()
    pixels = picture.pixels
    if heatmap is not None:
        from ..rendering.heat_map import draw_heat_map_of

        size = pixels.shape[1], pixels.shape[0]
        pixels = draw_heat_map_of(picture.scene, picture.camera, *size, heatmap, picture.device)
    for path in output:
        write_picture(path, pixels)
    if hits is not None:
        state = picture.scene.state
        write_hits(hits, picture.hits, state.names, state.instance_names)
    return (time.perf_counter() - begin) * 1e3


def _make_facts(report: dict[str, Any]) -> Any:
    """Return the table of a picture's objects, trees, device and rays."""
    degenerate, validated, sah_cost = report["degenerate_triangles"], report["validated_pixels"], report["sah_cost"]
    scene = (
        describe_scene(report["instances"], report["geometries"], report["placed_primitives"])
        if "instances" in report
        else ""
    )
    counts = join_facts(
        "" if scene else report["mesh"],
        describe_count(report["triangles"], "triangle") if report["triangles"] else "",
        f"{degenerate:,} of them degenerate: never hit" if degenerate else "",
        describe_count(report["spheres"], "sphere") if report.get("spheres") else "",
    )
    trees = join_facts(
        describe_count(report["nodes"] or 0, "node"),
        f"depth {report['depth']}{' of both levels' if scene else ''}",
        f"SAH cost {sah_cost:.2f}" if sah_cost is not None else "",
        "from the cache" if report["tree_from_cache"] else describe_workers(report["workers"]),
    )
    checked = f"{'all trees' if scene else 'tree'} and {validated:,} pixels agree with the reference"
    return make_facts({
        "scene": scene,
        "geometry" if scene else "mesh": counts,
        "trees" if scene else "tree": trees if report["nodes"] else "",
        "device": f"{report['device']}, layout {report['layout']}",
        "picture": f"{report['width']} x {report['height']}, {report['hits']:,} of {report['rays']:,} rays hit, "
        f"{report['mrays_per_s']:.2f} Mray/s",
        "validated": checked if validated else "",
    })  # fmt: skip

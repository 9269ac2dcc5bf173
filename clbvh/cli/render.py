"""`clbvh render`: a picture of meshes or of a scene, and a table of the time of each phase."""

from __future__ import annotations

import json
import threading
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options, picture_options
from .signals import calling_on_interrupt
from .tables import (
    add_time,
    describe_count,
    describe_mesh,
    describe_scene,
    describe_workers,
    make_facts,
    make_times,
    print_tables,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..rendering.picture import Picture
    from ..rendering.render import RenderOptions
    from ..rendering.scene import Scene

# No estimate of the time that is left before this many seconds: the first samples say little.
_LEAST_S = 0.5


def render(
    context: typer.Context,
    sources: options.Sources,
    output: Annotated[
        list[Path],
        typer.Option("-o", "--output", help="File of the picture, .ppm or .png; may be given several times."),
    ],
    hits: Annotated[
        Path | None,
        typer.Option(
            "--hits",
            metavar="FILE.npz",
            help="Write t, u, v, prim_id, geometry_id and instance_id of every pixel, each (H, W), and the names.",
        ),
    ] = None,
    width: picture_options.Width = None,
    height: picture_options.Height = None,
    shading: picture_options.Shading = None,
    eye: picture_options.Eye = None,
    look_at: picture_options.LookAt = None,
    up: picture_options.Up = None,
    fov: picture_options.Fov = None,
    view: picture_options.View = None,
    frame: picture_options.Frame = None,
    camera: picture_options.CameraKind = None,
    aperture: Annotated[
        float | None,
        picture_options.scene_option("Opening of the lens: depth of field.", "0", metavar="DIAMETER"),
    ] = None,
    focus: Annotated[
        float | None,
        picture_options.scene_option(
            "Distance that is sharp with an aperture.", "that of the point looked at", metavar="DISTANCE"
        ),
    ] = None,
    light: Annotated[
        str | None,
        picture_options.scene_option("Direction to the light.", "above, to the left", metavar="X,Y,Z"),
    ] = None,
    cut: picture_options.CutPlane = None,
    cut_box: picture_options.CutBox = None,
    background: picture_options.Background = None,
    samples: picture_options.Samples = None,
    time_limit: picture_options.TimeLimit = None,
    keep: picture_options.Keep = False,
    seed: picture_options.Seed = None,
    smooth: picture_options.Smooth = None,
    ground: picture_options.Ground = None,
    transparent: picture_options.Transparent = None,
    wireframe: picture_options.ShowWireframe = False,
    wireframe_width: picture_options.WireframeWidth = None,
    wireframe_colour: picture_options.WireframeColour = None,
    exposure: picture_options.Exposure = None,
    tone_curve: picture_options.ToneCurve = None,
    max_bounces: picture_options.MaxBounces = None,
    clamp: picture_options.Clamp = None,
    environment: picture_options.Environment = None,
    environment_rotation: picture_options.EnvironmentRotation = None,
    environment_strength: picture_options.EnvironmentStrength = None,
    builder: options.Builder = options.DEFAULT_BUILDER,
    workers: options.Workers = None,
    bins: options.Bins = None,
    leaf_size: options.LeafSize = options.DEFAULT_LEAF_SIZE,
    traversal_cost: options.TraversalCost = options.DEFAULT_TRAVERSAL_COST,
    task_threshold: options.TaskThreshold = None,
    frontier: options.Frontier = options.DEFAULT_FRONTIER,
    quality: options.Quality = options.DEFAULT_QUALITY,
    cache: options.UseCache = False,
    cache_dir: options.CacheFolder = None,
    device: options.Device = None,
    layout: Annotated[
        str,
        options.device_option("Layout of the tree on the device: auto, bvh2, bvh4 or bvh8."),
    ] = "auto",
    heatmap: Annotated[
        str | None,
        typer.Option(
            metavar="nodes|triangles",
            help="Show the node steps of each ray instead, or its primitive tests, with a colour bar below.",
        ),
    ] = None,
    validate: Annotated[
        bool, typer.Option("--validate", help="Check the tree, and a sample of pixels against a slow reference.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Render meshes or a scene."""
    from ..builders.options import BuildOptions
    from ..errors import ConfigError
    from ..rendering.image_files import check_has_alpha, check_hits_path, check_picture_path
    from ..rendering.render import RenderOptions

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    if hits is not None:
        check_hits_path(hits)
    if heatmap is not None:
        from ..rendering.heat_map import check_quantity

        check_quantity(heatmap)
        if builder == "brute":
            raise ConfigError(
                "a heat map shows the steps through a tree, and the builder brute has none: take another one"
            )
    changes = picture_options.read_settings(context.params)
    if shading is None and environment is not None:
        changes["shading"] = "path"  # others see no environment
    light_direction = picture_options.parse_vector("--light", light)
    wanted = RenderOptions(
        builder=builder,
        workers=workers,
        build=BuildOptions(bins, leaf_size, traversal_cost, task_threshold, frontier, quality),
        cache=options.find_cache_folder(cache, cache_dir),
        device=device,
        layout=layout,
        validate=validate,
    )

    scene, load_timings_ms = _open(sources)
    scene = picture_options.with_view(scene, changes, camera, view)
    if scene.transparent and heatmap is None:
        for path in output:
            check_has_alpha(path)
    if light_direction is not None:
        scene = scene.with_changes(light=scene.light.with_direction(light_direction))
    picture = _render_with_status(scene, wanted, time_limit_s=time_limit, keeps=keep)
    report = picture.report()
    for phase, ms in load_timings_ms.items():
        report["timings_ms"][phase] += ms
    report["timings_ms"]["write"] = _write(picture, scene, output, hits, heatmap)
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print_report(report, picture)
    options.print_notes(picture.notes)
    if not report["hits"]:
        options.print_notes(["no ray hits anything: the picture shows the background only"])


def _open(sources: list[str]) -> tuple[Scene, dict[str, float]]:
    """Return the scene of the command line, and the times of the phases in which its objects were loaded."""
    from ..support.stopwatch import Stopwatch

    watch = Stopwatch()
    scene = options.open_sources(sources)
    if scene.is_one_mesh:
        return scene, {}  # loaded by the renderer, while the workers start
    watch.lap("load")
    return scene, dict.fromkeys(("load", "total"), watch.laps_ms["load"])


def _write(picture: Picture, scene: Scene, output: list[Path], hits: Path | None, heatmap: str | None) -> float:
    """Write all files and return the time in milliseconds."""
    from ..rendering.image_files import write_hits, write_picture

    begin = time.perf_counter()
    rgb = picture.pixels
    if heatmap is not None:
        from ..rendering.heat_map import draw_heat_map_of

        subject = picture.objects if picture.bvh is None else picture.bvh
        rgb = draw_heat_map_of(subject, picture.camera, rgb.shape[1], rgb.shape[0], heatmap)
    for path in output:
        write_picture(path, rgb)
    if hits is not None:
        if picture.mesh is not None:
            names: tuple[Sequence[str], Sequence[str]] = (picture.mesh.name,), (picture.mesh.name,)
        else:
            state = scene.snapshot()
            names = state.names, state.instance_names
        write_hits(hits, picture.hits, *names)
    return (time.perf_counter() - begin) * 1e3


def _render_with_status(
    scene: Scene, options: RenderOptions, *, time_limit_s: float | None = None, keeps: bool = False
) -> Picture:
    """Render, and show the phase, the share of the samples and the time that is left if stderr is a terminal.

    With `keeps`, Ctrl-C ends the picture early instead of the process.
    """
    from rich.console import Console

    from ..rendering.render import render

    stopped = threading.Event()
    console = Console(stderr=True)
    with console.status("") as status, calling_on_interrupt(stopped.set) if keeps else nullcontext():
        begin = time.perf_counter()

        def show(done: int, total: int) -> None:
            spent = time.perf_counter() - begin
            left = spent * (total - done) / done
            if time_limit_s is not None:
                status.update(f"render: {spent:.0f} of {time_limit_s:.0f} s ...")
            elif spent > _LEAST_S:
                status.update(f"render: {100 * done // total} %, about {left:.0f} s left ...")

        return render(
            scene, options, time_limit_s=time_limit_s, on_samples=show, is_stopped=stopped.is_set,
            on_phase=lambda phase: status.update(f"{phase} ..."),
        )  # fmt: skip


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


def _print_report(report: dict[str, Any], picture: Picture) -> None:
    """Print the tables of a picture: what was drawn, and the time of each phase."""
    from rich.markup import escape

    facts = make_facts()
    nodes = describe_count(report["nodes"], "node")
    made_by = "from the cache" if report["tree_from_cache"] else describe_workers(report["workers"])
    if picture.objects is not None:
        counts = report["instances"], report["geometries"], report["placed_primitives"]
        facts.add_row("scene", describe_scene(*counts))
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

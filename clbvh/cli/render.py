"""`clbvh render`: a picture of meshes or of a scene, and a table of the time of each phase."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options, picture_options, view_options
from .render_progress import render_with_status
from .render_report import print_render_report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..rendering.picture import Picture
    from ..rendering.scene import Scene

_SCENE = view_options.SCENE_PANEL


def render(
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
    width: view_options.Width = None,
    height: view_options.Height = None,
    shading: picture_options.Shading = None,
    eye: view_options.Eye = None,
    look_at: view_options.LookAt = None,
    up: view_options.Up = None,
    fov: view_options.Fov = None,
    view: view_options.View = None,
    frame: view_options.Frame = None,
    camera: view_options.CameraKind = None,
    aperture: Annotated[
        float | None,
        typer.Option(
            metavar="DIAMETER", help="Opening of the lens: depth of field.", show_default="0", rich_help_panel=_SCENE
        ),
    ] = None,
    focus: Annotated[
        float | None,
        typer.Option(
            metavar="DISTANCE",
            help="Distance that is sharp with an aperture.",
            show_default="that of the point looked at",
            rich_help_panel=_SCENE,
        ),
    ] = None,
    light: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="Direction to the light.", show_default="above, to the left", rich_help_panel=_SCENE
        ),
    ] = None,
    cut: view_options.CutPlane = None,
    cut_box: view_options.CutBox = None,
    background: view_options.Background = None,
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
        typer.Option(
            help="Layout of the tree on the device: auto, bvh2, bvh4 or bvh8.", rich_help_panel=options.DEVICE_PANEL
        ),
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
    from ..rendering.image_files import check_has_alpha, check_hits_path, check_picture_path
    from ..rendering.render import RenderOptions

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    if hits is not None:
        check_hits_path(hits)
    if heatmap is not None:
        _check_heat_map(heatmap, builder)
    changes: dict[str, Any] = {
        **view_options.parse_view(
            width=width,
            height=height,
            eye=eye,
            look_at=look_at,
            up=up,
            fov=fov,
            frame=frame,
            cut=cut,
            cut_box=cut_box,
            background=background,
        ),
        # Only paths see an environment.
        "shading": "path" if shading is None and environment is not None else shading,
        "samples": samples,
        "seed": seed,
        "smooth": smooth,
        "ground": ground,
        "transparent": transparent,
        "exposure": exposure,
        "wireframe": picture_options.parse_wireframe(wireframe, wireframe_width, wireframe_colour),
        "tone_curve": tone_curve,
        "max_bounces": max_bounces,
        "clamp": clamp,
        "environment": environment,
        "environment_rotation": environment_rotation,
        "environment_strength": environment_strength,
        "aperture": aperture,
        "focus_distance": focus,
    }
    light_direction = view_options.parse_vector("--light", light)
    wanted = RenderOptions(
        builder=builder,
        workers=workers,
        build=options.make_build_options(bins, leaf_size, traversal_cost, task_threshold, frontier, quality),
        cache=options.find_cache_folder(cache, cache_dir),
        device=device,
        layout=layout,
        validate=validate,
    )

    scene, load_timings_ms = _open(sources)
    scene = view_options.with_view(scene, changes, camera, view)
    if scene.transparent and heatmap is None:
        for path in output:
            check_has_alpha(path)
    if light_direction is not None:
        scene = scene.with_changes(light=scene.light.with_direction(light_direction))
    picture = render_with_status(scene, wanted, time_limit_s=time_limit, keeps=keep)
    report = picture.report()
    for phase, ms in load_timings_ms.items():
        report["timings_ms"][phase] += ms
    report["timings_ms"]["write"] = _write(picture, scene, output, hits, heatmap)
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        print_render_report(report, picture)
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


def _check_heat_map(quantity: str, builder: str) -> None:
    from ..errors import ConfigError
    from ..rendering.heat_map import check_quantity

    check_quantity(quantity)
    if builder == "brute":
        raise ConfigError("a heat map shows the steps through a tree, and the builder brute has none: take another one")


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
        geometry_names, instance_names = _list_names(picture, scene)
        write_hits(hits, picture.hits, geometry_names, instance_names)
    return (time.perf_counter() - begin) * 1e3


def _list_names(picture: Picture, scene: Scene) -> tuple[Sequence[str], Sequence[str]]:
    """Return the names of the geometries and of the instances, by their ids."""
    if picture.mesh is not None:
        return (picture.mesh.name,), (picture.mesh.name,)
    state = scene.snapshot()
    return state.names, state.instance_names

"""`clbvh images`: what each pixel sees, as files of numbers: depth, normals, ids and more."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import options, picture_options

if TYPE_CHECKING:
    from ..rendering.images.images import Images

# Those of `clbvh.render_images`, repeated because importing them would make `clbvh --help` slow. A test compares them.
DEFAULT_CHANNELS = "rgb,alpha,depth,normal,instance_id"


def images(
    context: typer.Context,
    sources: options.Sources,
    output: Annotated[
        list[Path],
        typer.Option(
            "-o",
            "--output",
            help="One file of all channels, .exr or .npz; or .png or .ppm: out.png stands for out-depth.png and so "
            "on, and out.json with their scales and the camera. May be given several times.",
        ),
    ],
    channels: Annotated[
        str,
        typer.Option(
            metavar="A,B,...",
            help="rgb, colour, alpha, depth (along the optical axis), range (from the eye), normal, normal_camera, "
            "shading_normal, shading_normal_camera, position, instance_id, geometry_id, primitive_id, barycentric, uv, "
            "motion.",
        ),
    ] = DEFAULT_CHANNELS,
    depth_scale: Annotated[
        float | None,
        typer.Option(
            help="Pixel values for a unit of length in PNG files, such as 1000.", show_default="a round one that fits"
        ),
    ] = None,
    width: picture_options.Width = None,
    height: picture_options.Height = None,
    camera: picture_options.CameraKind = None,
    camera_file: Annotated[
        Path | None,
        picture_options.scene_option(
            "Camera: intrinsics, camera_to_world and size, as in the .json file beside PNG files.",
            metavar="FILE.json",
            flag="--camera-file",
        ),
    ] = None,
    next_camera_file: Annotated[
        Path | None,
        picture_options.scene_option(
            "Camera of the second pose, for motion.", metavar="FILE.json", flag="--next-camera-file"
        ),
    ] = None,
    eye: picture_options.Eye = None,
    look_at: picture_options.LookAt = None,
    up: picture_options.Up = None,
    fov: picture_options.Fov = None,
    view: picture_options.View = None,
    frame: picture_options.Frame = None,
    cut: picture_options.CutPlane = None,
    cut_box: picture_options.CutBox = None,
    shading: picture_options.Shading = None,
    samples: picture_options.Samples = None,
    wireframe: picture_options.ShowWireframe = False,
    wireframe_width: picture_options.WireframeWidth = None,
    wireframe_colour: picture_options.WireframeColour = None,
    cache: options.UseCache = False,
    cache_dir: options.CacheFolder = None,
    device: options.Device = None,
    as_json: options.AsJson = False,
) -> None:
    """Write what each pixel sees: depth, normals, positions, ids, texture coordinates, motion."""
    from rich.console import Console

    from ..errors import ConfigError
    from ..rendering.images.channels import check_channels
    from ..rendering.images.files import FILES_SUFFIXES, check_images_path, read_camera
    from ..rendering.render import render_images
    from ..rendering.subjects import RenderOptions

    # All input is checked before any work.
    names = check_channels([name.strip() for name in channels.split(",") if name.strip()])
    for path in output:
        check_images_path(path, names)
    if camera_file is not None and any(value is not None for value in (camera, eye, look_at, up, fov, view, frame)):
        raise ConfigError(
            "--camera-file says all of the view: give it without --camera, --eye, --look-at, --up, --fov, --view and "
            "--frame"
        )
    if "motion" in names and next_camera_file is None:
        raise ConfigError("the channel motion needs a second pose: give --next-camera-file")
    first, second = (None if path is None else read_camera(path) for path in (camera_file, next_camera_file))
    changes = picture_options.read_settings(context.params, without=("width", "height", "shading", "samples"))
    wanted = RenderOptions(cache=options.find_cache_folder(cache, cache_dir), device=device)
    scene = picture_options.with_view(options.open_sources(sources), changes, camera, view)

    begin = time.perf_counter()
    notes: list[str] = []
    with Console(stderr=True).status("") as status:
        made = render_images(
            scene, names, wanted, camera=first, next_camera=second, width=width, height=height, shading=shading,
            samples=samples, on_phase=lambda phase: status.update(f"{phase} ..."), on_note=notes.append,
        )  # fmt: skip
    made_s = time.perf_counter() - begin
    for path in output:
        made.save(path, depth_scale=depth_scale if path.suffix.lower() in FILES_SUFFIXES else None)
    _report(made, output, made_s, time.perf_counter() - begin - made_s, as_json)
    options.print_notes(notes)


def _report(made: Images, output: list[Path], made_s: float, write_s: float, as_json: bool) -> None:
    """Print what was written: each channel with the least and the greatest value of its hits."""
    from rich.table import Table

    from ..rendering.images.channels import find_limits
    from .tables import make_table, print_tables

    limits = {name: find_limits(name, array) for name, array in made.items()}
    if as_json:
        report = {
            "width": made.width,
            "height": made.height,
            "channels": {name: None if pair is None else list(pair) for name, pair in limits.items()},
            "files": [str(path) for path in output],
            "timings_ms": {"images": made_s * 1e3, "write": write_s * 1e3},
        }
        print(json.dumps(report, indent=2))
        return
    table = make_table("channel", "least", "greatest", numbers=("least", "greatest"))
    for name, pair in limits.items():
        table.add_row(name, *(("no values",) if pair is None else (f"{value:,.6g}" for value in pair)))
    files = Table(box=None, show_header=False, pad_edge=False)
    files.add_row(f"{made.width} x {made.height}, {made_s:.2f} s, written in {write_s:.2f} s")
    print_tables(table, files)

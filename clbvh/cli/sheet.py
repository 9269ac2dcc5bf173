"""`clbvh sheet`: the standard views of meshes or of a scene in one picture."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from . import options, picture_options

# Those of `clbvh.contact_sheet`, repeated because importing them would make `clbvh --help` slow. A test compares them.
DEFAULT_WIDTH, DEFAULT_HEIGHT = 400, 300


def sheet(
    context: typer.Context,
    sources: options.Sources,
    output: Annotated[
        list[Path],
        typer.Option("-o", "--output", help="File of the picture, .png or .ppm; may be given several times."),
    ],
    width: Annotated[int, picture_options.scene_option("Pixels of each view.")] = DEFAULT_WIDTH,
    height: Annotated[int, picture_options.scene_option("Pixels of each view.")] = DEFAULT_HEIGHT,
    shading: picture_options.Shading = None,
    up: picture_options.Up = None,
    frame: picture_options.Frame = None,
    cut: picture_options.CutPlane = None,
    cut_box: picture_options.CutBox = None,
    background: picture_options.Background = None,
    samples: picture_options.Samples = None,
    seed: picture_options.Seed = None,
    smooth: picture_options.Smooth = None,
    ground: Annotated[
        bool,
        picture_options.samples_option("Show shadows on a ground (studio).", flag="--ground"),
    ] = False,
    wireframe: picture_options.ShowWireframe = False,
    wireframe_width: picture_options.WireframeWidth = None,
    wireframe_colour: picture_options.WireframeColour = None,
    exposure: picture_options.Exposure = None,
    tone_curve: picture_options.ToneCurve = None,
    cache: options.UseCache = False,
    cache_dir: options.CacheFolder = None,
    device: options.Device = None,
    as_json: options.AsJson = False,
) -> None:
    """Write the standard views of meshes or a scene, at one scale, as one picture."""
    from rich.console import Console

    from ..rendering.contact_sheet import contact_sheet
    from ..rendering.image_files import check_picture_path
    from ..rendering.subjects import RenderOptions

    # All input is checked before any work.
    for path in output:
        check_picture_path(path)
    # Those of one view, and the ground of all.
    changes = picture_options.read_settings(context.params, without=("width", "height", "ground"))
    wanted = RenderOptions(cache=options.find_cache_folder(cache, cache_dir), device=device)
    scene = options.open_sources(sources).with_changes(**changes)

    notes: list[str] = []
    begin = time.perf_counter()
    with Console(stderr=True).status("") as status:
        made = contact_sheet(
            scene, wanted, width=width, height=height, ground=ground,
            on_phase=lambda phase: status.update(f"{phase} ..."), on_note=notes.append,
        )  # fmt: skip
    for path in output:
        made.save(path)
    spent_s = time.perf_counter() - begin
    rows, columns, _ = made.rgb.shape
    if as_json:
        report = {
            "width": columns,
            "height": rows,
            "views": list(made.pictures),
            "pixel_size": made.pixel_size,
            "files": [str(path) for path in output],
            "timings_ms": {"total": spent_s * 1e3},
        }
        print(json.dumps(report, indent=2))
    else:
        for path in output:
            print(f"{path}: {len(made.pictures)} views, {columns} x {rows}, made in {spent_s:,.1f} s")
    options.print_notes(notes)

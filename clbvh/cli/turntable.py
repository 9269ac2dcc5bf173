"""`clbvh turntable`: an animation of meshes or of a scene that turn once around."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import options, picture_options

if TYPE_CHECKING:
    from ..rendering.scene import Scene

# Those of `clbvh.render_turntable`, repeated because importing them would make `clbvh --help` slow. A test compares
# them.
DEFAULT_FRAMES = 72
DEFAULT_FRAME_RATE = 25.0


def turntable(
    context: typer.Context,
    sources: options.Sources,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="File of the animation, .mp4 (needs imageio-ffmpeg) or .gif.")
    ],
    frames: Annotated[int, typer.Option(help="Pictures of a full turn.")] = DEFAULT_FRAMES,
    frame_rate: Annotated[float, typer.Option("--fps", help="Pictures shown in a second.")] = DEFAULT_FRAME_RATE,
    width: picture_options.Width = None,
    height: picture_options.Height = None,
    shading: picture_options.Shading = None,
    up: picture_options.Up = None,
    frame: picture_options.Frame = None,
    cut: picture_options.CutPlane = None,
    cut_box: picture_options.CutBox = None,
    background: picture_options.Background = None,
    camera: picture_options.CameraKind = None,
    samples: picture_options.Samples = None,
    seed: picture_options.Seed = None,
    smooth: picture_options.Smooth = None,
    ground: picture_options.Ground = None,
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
    """Write an animation in which meshes or a scene turn once around."""
    from rich.console import Console

    from ..rendering.subjects import RenderOptions
    from ..rendering.turntable import check_animation, check_frame_count, render_turntable

    # All input is checked before any work.
    check_animation(output, frame_rate)
    check_frame_count(frames)
    changes = picture_options.read_settings(context.params)
    wanted = RenderOptions(cache=options.find_cache_folder(cache, cache_dir), device=device)
    scene = picture_options.with_view(options.open_sources(sources), changes, camera)

    begin = phase_begin = time.perf_counter()
    notes: list[str] = []
    with Console(stderr=True).status("") as status:

        def enter(phase: str) -> None:
            nonlocal phase_begin
            phase_begin = time.perf_counter()
            status.update(f"{phase} ...")

        def show(done: int, total: int) -> None:
            left = (time.perf_counter() - phase_begin) * (total - done) / done
            status.update(f"render: frame {done} of {total}, about {left:.0f} s left ...")

        render_turntable(
            scene, output, wanted, frames=frames, frames_per_s=frame_rate, on_frame=show, on_phase=enter,
            on_note=notes.append,
        )  # fmt: skip
    _report(scene, output, frames, frame_rate, time.perf_counter() - begin, as_json)
    options.print_notes(notes)


def _report(scene: Scene, output: Path, frames: int, frame_rate: float, spent_s: float, as_json: bool) -> None:
    if as_json:
        report = {
            "width": scene.width,
            "height": scene.height,
            "frames": frames,
            "frames_per_s": frame_rate,
            "bytes": output.stat().st_size,
            "files": [str(output)],
            "timings_ms": {"total": spent_s * 1e3},
        }
        print(json.dumps(report, indent=2))
        return
    print(
        f"{output}: {frames:,} frames of {scene.width} x {scene.height}, {frames / frame_rate:,.1f} s, "
        f"{output.stat().st_size / 1e6:,.1f} MB, made in {spent_s:,.1f} s"
    )

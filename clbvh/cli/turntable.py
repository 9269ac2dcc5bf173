"""`clbvh turntable`: an animation of meshes or of a scene that turn once around."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..choices import DEFAULT_FRAME_RATE, DEFAULT_FRAMES
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import print_json, print_notes

# Of one camera.
_WITHOUT = "eye", "look_at", "side", "fov", "aperture", "focus_distance", "transparent"

_RATE_HELP = "Pictures shown in a second."
_OUTPUT_HELP = "File of the animation, .mp4 (needs imageio-ffmpeg) or .gif."


@options.with_options(changes=options.list_view_options(without=_WITHOUT), tree=options.list_tree_options())
def turntable(
    *sources: options.Sources,
    output: Annotated[Path, Parameter(name=("--output", "-o"), metavar="FILE", help=_OUTPUT_HELP)],
    frames: Annotated[
        int, Parameter(help="Pictures of a full turn.", converter=options.read_whole, show_default=True)
    ] = DEFAULT_FRAMES,
    frame_rate: Annotated[float, Parameter(name="--fps", help=_RATE_HELP, show_default=True)] = DEFAULT_FRAME_RATE,
    changes: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Write an animation in which meshes or a scene turn once around."""
    from ..rendering.turntable import check_animation, check_frame_count, render_turntable

    # All input is checked before any work.
    check_animation(output, frame_rate)
    check_frame_count(frames)
    wanted = options.make_options(RenderOptions, tree)
    with Progress() as progress:
        view = render_turntable(
            list(sources), output, None, wanted, frames=frames, frames_per_s=frame_rate, on_frame=progress.show_share,
            on_phase=progress.enter, on_note=progress.notes.append, **options.read_changes(changes),
        )  # fmt: skip
    size = output.stat().st_size
    report = {
        "width": view.width,
        "height": view.height,
        "frames": frames,
        "frames_per_s": frame_rate,
        "bytes": size,
        "files": [str(output)],
        "timings_ms": {"total": progress.spent_s * 1e3},
    }
    if as_json:
        print_json(report)
    else:
        print(
            f"{output}: {frames:,} frames of {view.width} x {view.height}, {frames / frame_rate:,.1f} s, "
            f"{size / 1e6:,.1f} MB, made in {progress.spent_s:,.1f} s"
        )
    print_notes(progress.notes)

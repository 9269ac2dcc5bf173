"""`clbvh turntable`: an animation of meshes or of a scene that turn once around."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..choices import DEFAULT_FRAME_RATE, DEFAULT_FRAMES
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import print_report

_WITHOUT = (*options.POSE, "transparent")


@options.with_options(view=options.list_view_options(without=_WITHOUT), tree=options.list_tree_options())
def turntable(
    *sources: options.Sources,
    output: Annotated[Path, options.OUTPUT],
    frames: Annotated[int, Parameter(converter=options.read_whole, show_default=True)] = DEFAULT_FRAMES,
    frame_rate: Annotated[float, Parameter(name="--fps", show_default=True)] = DEFAULT_FRAME_RATE,
    view: options.Given = options.NOTHING,
    tree: options.Given = options.NOTHING,
    as_json: options.AsJson = False,
) -> None:
    """Write an animation in which meshes or a scene turn once around.

    Parameters
    ----------
    output
        File of the animation, .mp4 (needs imageio-ffmpeg) or .gif.
    frames
        Pictures of a full turn.
    frame_rate
        Pictures shown in a second.
    """
    from ..rendering.series import check_animation, check_frame_count, render_turntable

    # All input is checked before any work.
    check_animation(output, frame_rate)
    check_frame_count(frames)
    wanted = options.make_options(RenderOptions, tree)
    changes = options.read_changes(view) | {"frames": frames, "frames_per_s": frame_rate}
    with Progress() as progress:
        seen = render_turntable(
            list(sources), output, None, wanted, on_frame=progress.show_share, **progress.callbacks, **changes
        )
    size, spent_s = output.stat().st_size, progress.spent_s
    report = {
        "width": seen.width,
        "height": seen.height,
        "frames": frames,
        "frames_per_s": frame_rate,
        "bytes": size,
        "files": [output],
        "timings_ms": {"total": spent_s * 1e3},
    }
    line = (
        f"{output}: {frames:,} frames of {seen.width} x {seen.height}, {frames / frame_rate:,.1f} s, "
        f"{size / 1e6:,.1f} MB, made in {spent_s:,.1f} s"
    )
    print_report(report, line, as_json=as_json, notes=progress.notes)

"""`clbvh turntable`: an animation of meshes or of a scene that turn once around."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from ..choices import DEFAULT_FRAME_RATE, DEFAULT_FRAMES
from ..errors import ConfigError
from ..rendering.options import RenderOptions
from . import options
from .progress import Progress
from .tables import print_report

# For the first answer of a cluster.
_PATIENCE_S = 10

_WITHOUT = (*options.POSE, "transparent")


@options.with_options(view=options.list_view_options(without=_WITHOUT), tree=options.list_tree_options())
def turntable(
    *sources: options.Sources,
    output: Annotated[Path, options.OUTPUT],
    frames: Annotated[int, Parameter(converter=options.read_whole, show_default=True)] = DEFAULT_FRAMES,
    frame_rate: Annotated[float, Parameter(name="--fps", show_default=True)] = DEFAULT_FRAME_RATE,
    cluster: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    point_radius: options.PointRadius = None,
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
    cluster
        Scheduler of a Dask cluster whose workers render the frames, such as tcp://host:8786.
    """
    from ..files.animations import check_animation
    from ..rendering.series import check_frame_count, render_turntable

    # All input is checked before any work.
    check_animation(output, frame_rate)
    check_frame_count(frames)
    wanted = options.make_options(RenderOptions, tree)
    changes = options.read_changes(view) | {"frames": frames, "frames_per_s": frame_rate}
    source = options.find_source(sources, point_radius)
    with Progress() as progress:
        seen = render_turntable(
            source, output, None, wanted, on_frame=progress.show_share,
            draw=None if cluster is None else partial(_draw_on, cluster, source, wanted),
            **progress.callbacks, **changes,
        )  # fmt: skip
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


def _draw_on(cluster: str, source: Any, wanted: RenderOptions, views: list[Any]) -> Iterator[Any]:
    """Yield the frames that the workers of a cluster render of a scene, which goes to them as it is here."""
    try:
        from distributed import Client

        from ..integrations.dask import render_frames
    except ImportError as error:
        raise ConfigError(f"--cluster needs Dask: run \"pip install 'clbvh[dask]'\" ({error})") from error
    from ..rendering.scene_ref import SceneRef

    try:
        client = Client(cluster, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{cluster}: no scheduler of a Dask cluster answers there: {error}") from error
    with client:
        frames = client.compute(render_frames(SceneRef.embed(source), views, wanted))
        while frames:
            # The cluster forgets it then.
            yield frames.pop(0).result()

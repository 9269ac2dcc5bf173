"""Turntables: an animation of a scene that turns once around."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh
from ..errors import ConfigError
from .as_scene import SceneLike, as_scene
from .formats.animation import DEFAULT_FRAME_RATE, check_animation, write_animation
from .render_options import RenderOptions
from .renderer import Renderer
from .standard_views import STANDARD_VIEWS
from .vectors import Vector

DEFAULT_FRAMES = 72

# An hour at 25 frames per second.
_MOST_FRAMES = 90_000


def render_turntable(
    source: SceneLike,
    path: str | os.PathLike[str],
    options: RenderOptions | None = None,
    *,
    frames: int = DEFAULT_FRAMES,
    frames_per_s: float = DEFAULT_FRAME_RATE,
    width: int | None = None,
    height: int | None = None,
    shading: str | None = None,
    samples: int | None = None,
    up: Vector | None = None,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
    on_phase: Callable[[str], None] = lambda phase: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> None:
    """Write an animation of a full turn, as GIF, which repeats for ever, or MP4, by the suffix of the name.

    The camera and the automatic light stay, and the scene turns, as on a turntable; see `Renderer.turntable`. A
    transparent background is drawn in the background's colours.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        See `render`.
    path : str or path
        Ends in ``.gif`` or ``.mp4``. The file appears when it is complete: an error or Ctrl-C leaves nothing behind.
    options : RenderOptions, optional
    frames : int
        Of the turn, at most 90,000.
    frames_per_s : float
        See `Notes`.
    width, height : int, pixels
        By default the scene's.
    shading, samples : optional
        See `Renderer.render`.
    up : (3,) float
        The axis of the turn; by default the scene's `up`.
    on_frame : function, optional
        Called with the frames that are done, and with all, after each.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.

    Raises
    ------
    ConfigError
        Another suffix, a number that is out of range, a file that cannot be written, or an MP4 file and imageio-ffmpeg
        is not installed.
    SceneError, MeshError, DeviceError, KernelBuildError, PoolError, ValidationError
        See `render`.

    Notes
    -----
    Frames are rendered and encoded one at a time. A GIF has 256 colours in each frame, and shows it for a whole number
    of 1/100 s, at least 2.

    Examples
    --------
    >>> import clbvh
    >>> import tempfile
    >>> from pathlib import Path
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     clbvh.render_turntable(ball, Path(folder, "ball.gif"), frames=4, width=64, height=48)
    ...     Path(folder, "ball.gif").is_file()
    True
    """
    check_animation(path, frames_per_s)
    check_frame_count(frames)
    # A tree is not built again; its scene has the default settings.
    opaque = source if isinstance(source, Bvh) else as_scene(source).with_changes(transparent=False)
    with Renderer(opaque, options, on_phase=on_phase) as renderer:
        size: dict[str, Any] = {"width": width, "height": height}
        cameras = renderer.turntable(frames, up=up, **size)
        for note in renderer.list_notes(renderer.scene.with_view(STANDARD_VIEWS[0]).with_changes(up=up)):
            on_note(note)
        on_phase("render")

        def draw_frames() -> Iterator[NDArray[np.uint8]]:
            for number, camera in enumerate(cameras):
                yield renderer.render(camera=camera, shading=shading, samples=samples, **size).rgb
                on_frame(number + 1, frames)

        write_animation(path, draw_frames(), frames_per_s)


def check_frame_count(frames: int) -> None:
    """Raise `ConfigError` for a number of frames that is out of range."""
    if isinstance(frames, bool) or not isinstance(frames, Integral) or not 1 <= int(frames) <= _MOST_FRAMES:
        raise ConfigError(f"the frames of a turn are a whole number from 1 to {_MOST_FRAMES:,}, not {frames!r}")

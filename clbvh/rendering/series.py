"""Several views of a scene in one file: contact sheets and turntables."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..choices import DEFAULT_FRAME_RATE, DEFAULT_FRAMES, SHEET_HEIGHT, SHEET_WIDTH, STANDARD_VIEWS
from ..errors import ConfigError
from ..files.animations import check_animation, write_animation
from ..files.image_files import GAP, GROUND, INK, TEXT_ROWS, draw_text, encode_picture, width_of, write_picture
from ..files.open_scene import SceneLike
from ..views.cameras.projection import Orthographic
from ..views.view import View
from .options import RenderOptions
from .picture import Picture
from .renderer import Renderer

_COLUMNS = 4

# Width of a view, in pixels, for each pixel of the font.
_FONT_STEP = 180

# The ruler is a round length, of at most this share of a view's width.
_RULER_SHARE = 0.6


@dataclass(frozen=True, eq=False)
class ContactSheet:
    """The standard views of a scene in one picture.

    Attributes
    ----------
    rgb : (height, width, 3) uint8, sRGB
    pictures : dict of str to Picture
        By the names of the views, in the order of the sheet.
    pixel_size : float, the scene's units
        Side of a pixel, in every view.

    Examples
    --------
    >>> import clbvh
    >>> sheet = clbvh.contact_sheet(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
    >>> sheet
    ContactSheet(256 x 118: front, right, back, left, top, bottom, iso)
    """

    rgb: NDArray[np.uint8]
    pictures: dict[str, Picture]
    pixel_size: float

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the sheet to a file, ``.png``, ``.jpg`` or ``.ppm`` by its name: completely or not at all.

        Raises
        ------
        ConfigError
            The name has another suffix, or the file cannot be written.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> sheet = clbvh.contact_sheet(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sheet.save(Path(folder, "sphere.png"))
        """
        write_picture(path, self.rgb)

    def _repr_png_(self) -> bytes:
        """Return the sheet as PNG, for notebooks."""
        return encode_picture(self.rgb, ".png")

    def __repr__(self) -> str:
        height, width, _ = self.rgb.shape
        return f"ContactSheet({width} x {height}: {', '.join(self.pictures)})"


def contact_sheet(
    source: SceneLike | list[str],
    view: View | None = None,
    options: RenderOptions | None = None,
    *,
    on_phase: Callable[[str], None] | None = None,
    on_note: Callable[[str], None] | None = None,
    **changes: Any,
) -> ContactSheet:
    """Return the standard views of a scene in one picture: front, right, back, left, top, bottom and isometric.

    The views are orthographic and have one scale. Each has its name and the size of what it shows below it, in the
    scene's units; the last place has the name of the mesh, its size, and a ruler.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Spheres, Mesh, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        See `render`.
    view : View, optional
        By default that of the scene file, or `View()`. Its camera is left out, and its background is drawn even if it
        is transparent.
    options : RenderOptions, optional
    on_phase : function, optional
        Called with the name of each phase and of each view as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.
    **changes
        Settings of `View`, in place of those of the view. The size is that of each view, by default 400 x 300; there is
        no ground unless `ground=True` asks for one, which only the views from above show.

    Raises
    ------
    SceneError, MeshError, ConfigError, DeviceError, KernelBuildError, PoolError, ValidationError
        See `render`.

    Examples
    --------
    >>> import clbvh
    >>> sheet = clbvh.contact_sheet(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
    >>> list(sheet.pictures)
    ['front', 'right', 'back', 'left', 'top', 'bottom', 'iso']
    """
    settings = {"width": SHEET_WIDTH, "height": SHEET_HEIGHT, "ground": False} | changes
    with Renderer(source, view, options, on_phase=on_phase, **settings) as renderer:
        front = renderer.view.changed(side=STANDARD_VIEWS[0], transparent=False)
        sizes = renderer.measure_views(up=front.up, frame=front.frame)
        # One scale for all sides: that of the tallest.
        levelled = [renderer.find_camera(front, side=side, projection=Orthographic()) for side in STANDARD_VIEWS]
        height = max(camera.projection.height for camera in levelled)  # type: ignore[union-attr, type-var]
        pictures = {}
        for side in STANDARD_VIEWS:
            if on_phase is not None:
                on_phase(side)
            pictures[side] = renderer.render(front.changed(side=side, projection=Orthographic(height)))
        if on_note is not None:
            for note in renderer.list_notes(front):
                on_note(note)
    pixel_size = float(height) / front.height  # type: ignore[arg-type]
    cells = [_caption(pictures[view].rgb, view, _join(*sizes[view])) for view in STANDARD_VIEWS]
    cells.append(_draw_panel(pictures["front"], (*sizes["front"], sizes["right"][0]), pixel_size, cells[0].shape))
    rows = [np.hstack(cells[begin : begin + _COLUMNS]) for begin in range(0, len(cells), _COLUMNS)]
    return ContactSheet(np.vstack(rows), pictures, pixel_size)


def _join(*lengths: float) -> str:
    return " x ".join(f"{length:.4g}" for length in lengths)


def _caption(rgb: NDArray[np.uint8], view: str, size: str) -> NDArray[np.uint8]:
    """Return a view with its name below it, and its size where there is room."""
    width = rgb.shape[1]
    scale = max(1, width // _FONT_STEP)
    strip = np.full(((TEXT_ROWS + 4 * GAP) * scale, width, 3), GROUND, np.uint8)
    text = f"{view}  {size}" if width_of(f"{view}  {size}", scale) <= width else view
    draw_text(strip, text, 2 * GAP * scale, width // 2, scale)
    return np.vstack((rgb, strip))


def _draw_panel(
    picture: Picture, size: tuple[float, ...], pixel_size: float, shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """Return a panel with the name of a scene, its size, and a ruler."""
    height, width, _ = shape
    scale = max(1, width // _FONT_STEP)
    panel = np.full(shape, GROUND, np.uint8)
    kind = "instances" if picture.mesh is None else "triangles"
    length = _round_down(_RULER_SHARE * width * pixel_size)
    # The name of a scene of several objects is their number.
    names = dict.fromkeys((picture.name, f"{picture.report()[kind]:,} {kind}"))
    lines = [*names, _join(*size), _join(length)]
    step = (TEXT_ROWS + 5 * GAP) * scale
    top = max(0, (height - (len(lines) + 1) * step) // 2)
    for number, line in enumerate(lines):
        while len(line) > 1 and width_of(line, scale) > width:
            line = line[:-1]
        draw_text(panel, line, top + number * step, width // 2, scale)
    # The ruler, with a mark at each end.
    top, across = top + len(lines) * step, round(length / pixel_size)
    left = (width - across) // 2
    panel[top + 2 * scale : top + 3 * scale, left : left + across] = INK
    for end in (left, left + across - scale):
        panel[top : top + 5 * scale, end : end + scale] = INK
    return panel


def _round_down(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((step * power for step in (1, 2, 5) if step * power <= length), default=length)


# An hour at 25 frames per second.
_MOST_FRAMES = 90_000


def render_turntable(
    source: SceneLike | list[str],
    path: str | os.PathLike[str],
    view: View | None = None,
    options: RenderOptions | None = None,
    *,
    frames: int = DEFAULT_FRAMES,
    frames_per_s: float = DEFAULT_FRAME_RATE,
    on_frame: Callable[[int, int], None] | None = None,
    on_phase: Callable[[str], None] | None = None,
    on_note: Callable[[str], None] | None = None,
    draw: Callable[[list[View]], Iterable[NDArray[np.uint8]]] | None = None,
    **changes: Any,
) -> View:
    """Write an animation of a full turn, as GIF, which repeats for ever, or MP4, by the suffix of the name.

    The camera and the automatic light stay, and the scene turns, as on a turntable; see `Renderer.turntable`. A
    transparent background is drawn in the background's colours.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Spheres, Mesh, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        See `render`.
    path : str or path
        Ends in ``.gif`` or ``.mp4``. The file appears when it is complete: an error or Ctrl-C leaves nothing behind.
    view : View, optional
        By default that of the scene file, or `View()`. Its `up` is the axis of the turn.
    options : RenderOptions, optional
    frames : int
        Of the turn, at most 90,000.
    frames_per_s : float
        See `Notes`.
    on_frame : function, optional
        Called with the frames that are done, and with all, after each.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.
    draw : function, optional
        Returns the frames of views, (height, width, 3) uint8 each, one after the other, in place of this process.
    **changes
        Settings of `View`, in place of those of the view.

    Returns
    -------
    View
        That of the frames.

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
    ...     view = clbvh.render_turntable(ball, Path(folder, "ball.gif"), frames=4, width=64, height=48)
    ...     Path(folder, "ball.gif").is_file()
    True
    """
    target = check_animation(path, frames_per_s)
    check_frame_count(frames)
    with Renderer(source, view, options, on_phase=on_phase, **changes) as renderer:
        turned = renderer.view.changed(transparent=False)
        cameras = renderer.turntable(frames, turned)
        if on_note is not None:
            for note in renderer.list_notes(turned.changed(side=STANDARD_VIEWS[0])):
                on_note(note)
        if on_phase is not None:
            on_phase("render")

        def draw_frames() -> Iterator[NDArray[np.uint8]]:
            views = [turned.changed(camera=camera) for camera in cameras]
            pictures = (renderer.render(view).rgb for view in views) if draw is None else draw(views)
            for number, picture in enumerate(pictures):
                yield picture
                if on_frame is not None:
                    on_frame(number + 1, frames)

        write_animation(target, draw_frames(), frames_per_s)
    return turned


def check_frame_count(frames: int) -> None:
    """Raise `ConfigError` for a number of frames that is out of range."""
    if isinstance(frames, bool) or not isinstance(frames, Integral) or not 1 <= int(frames) <= _MOST_FRAMES:
        raise ConfigError(f"the frames of a turn are a whole number from 1 to {_MOST_FRAMES:,}, not {frames!r}")

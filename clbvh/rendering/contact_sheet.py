"""Contact sheets: the standard views of a scene in one picture, at one scale."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .image_files import GAP, GROUND, INK, TEXT_ROWS, draw_text, encode_picture, width_of, write_picture
from .open_scene import SceneLike
from .picture import Picture
from .pose import STANDARD_VIEWS
from .renderer import Renderer
from .subjects import RenderOptions
from .vectors import Vector

DEFAULT_WIDTH, DEFAULT_HEIGHT = 400, 300

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
        """Write the sheet to a file, ``.ppm`` or ``.png`` by its name: completely or not at all.

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
    source: SceneLike,
    options: RenderOptions | None = None,
    *,
    width: int = DEFAULT_WIDTH,
    height: int = DEFAULT_HEIGHT,
    shading: str | None = None,
    samples: int | None = None,
    up: Vector | None = None,
    ground: bool = False,
    on_phase: Callable[[str], None] = lambda phase: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> ContactSheet:
    """Return the standard views of a scene in one picture: front, right, back, left, top, bottom and isometric.

    The views are orthographic and have one scale. Each has its name and the size of what it shows below it, in the
    scene's units; the last place has the name of the mesh, its size, and a ruler.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        See `render`. The scene's camera is left out, and its background is drawn even if it is transparent.
    options : RenderOptions, optional
    width, height : int, pixels
        Of each view.
    shading, samples : optional
        See `Renderer.render`.
    up : (3,) float
        By default the scene's `up`.
    ground : bool
        Whether there are shadows on a ground, which only the views from above show.
    on_phase : function, optional
        Called with the name of each phase and of each view as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.

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
    with Renderer(source, options, on_phase=on_phase) as renderer:
        # Seen from a side, so that up in the world is the scene's, and not that of a view from the top.
        scene = renderer.scene.with_view(STANDARD_VIEWS[0])
        scene = scene.with_changes(width=width, height=height, up=up, ground=ground, transparent=False)
        for note in renderer.list_notes(scene):
            on_note(note)
        renderer.scene = scene
        pictures = {}
        for view, camera in renderer.orthographic_views().items():
            on_phase(view)
            pictures[view] = renderer.render(camera=camera, shading=shading, samples=samples, on_phase=on_phase)
        sizes = renderer.measure_views(STANDARD_VIEWS)
    pixel_size = _pixel_size_of(next(iter(pictures.values())))
    cells = [_caption(pictures[view].rgb, _describe(view, sizes[view])) for view in STANDARD_VIEWS]
    cells.append(_draw_panel(pictures["front"], sizes, pixel_size, cells[0].shape))
    rows = [np.hstack(cells[begin : begin + _COLUMNS]) for begin in range(0, len(cells), _COLUMNS)]
    return ContactSheet(np.vstack(rows), pictures, pixel_size)


def _pixel_size_of(picture: Picture) -> float:
    """Return the side of a pixel of an orthographic picture, in the scene's units."""
    return float(picture.camera.projection.height) / picture.rgb.shape[0]  # type: ignore[union-attr, arg-type]


def _describe(view: str, size: tuple[float, float]) -> list[str]:
    """Return captions of a view, the longest first."""
    return [f"{view}  {_join(size)}", view]


def _join(lengths: tuple[float, ...]) -> str:
    return " x ".join(map(_short, lengths))


def _short(length: float) -> str:
    return f"{length:.4g}"


def _caption(rgb: NDArray[np.uint8], texts: list[str]) -> NDArray[np.uint8]:
    """Return a view with the first of the texts that fits below it."""
    width, scale = rgb.shape[1], _scale_of(rgb.shape[1])
    strip = np.empty(((TEXT_ROWS + 4 * GAP) * scale, width, 3), np.uint8)
    strip[:] = GROUND
    text = next((text for text in texts if width_of(text, scale) <= width), texts[-1])
    draw_text(strip, text, 2 * GAP * scale, width // 2, scale)
    return np.vstack((rgb, strip))


def _scale_of(width: int) -> int:
    return max(1, width // _FONT_STEP)


def _draw_panel(
    picture: Picture, sizes: dict[str, tuple[float, float]], pixel_size: float, shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """Return a panel with the name of a scene, its size, and a ruler."""
    height, width, _ = shape
    scale = _scale_of(width)
    panel = np.empty(shape, np.uint8)
    panel[:] = GROUND
    (across, high), (deep, _) = sizes["front"], sizes["right"]
    # The name of a scene of several objects is their number.
    lines = [*dict.fromkeys((picture.name, _count(picture))), _join((across, high, deep))]
    step = (TEXT_ROWS + 5 * GAP) * scale
    length = _round_down(_RULER_SHARE * width * pixel_size)
    top = max(0, (height - (len(lines) + 2) * step) // 2)
    for number, line in enumerate([*lines, _short(length)]):
        draw_text(panel, _fit(line, width, scale), top + number * step, width // 2, scale)
    _draw_ruler(panel, top + len(lines) * step + step, round(length / pixel_size), scale)
    return panel


def _draw_ruler(panel: NDArray[np.uint8], top: int, length: int, scale: int) -> None:
    """Draw a bar of `length` pixels, with a mark at each end."""
    left = (panel.shape[1] - length) // 2
    panel[top + 2 * scale : top + 3 * scale, left : left + length] = INK
    for end in (left, left + length - scale):
        panel[top : top + 5 * scale, end : end + scale] = INK


def _count(picture: Picture) -> str:
    report = picture.report()
    if picture.mesh is not None:
        return f"{report['triangles']:,} triangles"
    return f"{report['instances']:,} instances"


def _fit(text: str, width: int, scale: int) -> str:
    """Return the beginning of a text that fits."""
    return next((text[:end] for end in range(len(text), 1, -1) if width_of(text[:end], scale) <= width), text[:1])


def _round_down(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max((step * power for step in (1, 2, 5) if step * power <= length), default=length)

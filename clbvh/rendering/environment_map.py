"""The environment of a scene: a panorama of linear light, and the tables that paths draw light from.

See cl/film/lights.cl.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .look_tables import LUMINANCE

ENVIRONMENT_SUFFIXES = (".hdr", ".exr")

# 16384 x 8192: indices of three channels are int32 on the device, and float32 tells columns and rows apart.
_MAX_PIXELS = 2**27
_MAX_SIDE = 2**16

# Sums of brighter light over many samples would leave float32.
_MAX_LIGHT = 1e20


class EnvironmentMap:
    """A panorama of the light around all objects; an immutable value, read when it is first needed.

    Parameters
    ----------
    source : str, path or (h, w, 3) array
        A file, ``.hdr`` or ``.exr``, or linear red, green and blue, 0 or more; row 0 is the zenith's.

    Attributes
    ----------
    path : str, or None
        Of the file.

    Raises
    ------
    SceneError
        The name of the file has another suffix, or the array another shape or type, or a pixel that is no light.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> sky = np.zeros((32, 64, 3))
    >>> sky[:16] = (0.6, 0.7, 1.0)
    >>> clbvh.View(shading="path", environment=sky).environment
    EnvironmentMap(64 x 32)
    """

    path: str | None = None

    def __init__(self, source: Any) -> None:
        if isinstance(source, str | os.PathLike):
            self.path = os.fsdecode(source)
            if Path(self.path).suffix.lower() not in ENVIRONMENT_SUFFIXES:
                raise SceneError(
                    f"the environment must be a file whose name ends in {' or '.join(ENVIRONMENT_SUFFIXES)}, "
                    f"not {self.path!r}"
                )
        else:
            self.pixels = _check_pixels(source)

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """(h, w, 3) float32, linear; raises `SceneError` or `ConfigError` if the file has none.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.EnvironmentMap([[[1, 2, 3]]]).pixels
        array([[[1., 2., 3.]]], dtype=float32)
        """
        assert self.path is not None
        from .image_files import read_environment_map  # most pictures have no environment

        try:
            return _check_pixels(read_environment_map(self.path))
        except SceneError as error:
            if str(error).startswith(self.path):
                raise
            raise SceneError(f"{self.path}: {error}") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EnvironmentMap):
            return NotImplemented
        if self.path is not None or other.path is not None:
            return self.path == other.path
        return np.array_equal(self.pixels, other.pixels)

    def __hash__(self) -> int:
        return hash(self.pixels.shape if self.path is None else self.path)

    def __repr__(self) -> str:
        if self.path is not None:
            return f"EnvironmentMap({self.path!r})"
        height, width, _ = self.pixels.shape
        return f"EnvironmentMap({width} x {height})"


def as_environment(source: Any) -> EnvironmentMap | None:
    """Return the environment of a setting: a map, what a map is made from, or None."""
    return source if source is None or isinstance(source, EnvironmentMap) else EnvironmentMap(source)


def _check_pixels(source: Any) -> NDArray[np.float32]:
    """Return a read-only copy of an array as float32."""
    try:
        given = np.asarray(source)
    except ValueError as error:  # rows of different lengths
        raise SceneError(f"the environment must be a path or an (h, w, 3) array of numbers: {error}") from error
    if given.ndim != 3 or given.shape[2] != 3 or given.dtype.kind not in "iuf" or given.size == 0:
        raise SceneError(
            "the environment must be a path or an (h, w, 3) array of numbers, "
            f"not an array of {given.dtype} of shape {given.shape}"
        )
    height, width, _ = given.shape
    if height * width > _MAX_PIXELS or max(height, width) > _MAX_SIDE:
        raise SceneError(
            f"the environment has {width:,} x {height:,} pixels, and there is room for {_MAX_PIXELS:,}, "
            f"{_MAX_SIDE:,} on a side: make it smaller"
        )
    is_light = (given >= 0) & (given <= _MAX_LIGHT)  # False for NaN
    if not is_light.all():
        row, column, channel = (int(index) for index in np.argwhere(~is_light)[0])
        raise SceneError(
            f"the environment's light must be finite, from 0 to {_MAX_LIGHT:g}, "
            f"but the {('red', 'green', 'blue')[channel]} at row {row}, column {column} is "
            f"{given[row, column, channel]}"
        )
    pixels = np.array(given, np.float32, order="C")
    pixels.flags.writeable = False
    return pixels


# Shares of a pixel's area in which its neighbours on either side, and the pixel itself, make the light between the
# centres of pixels: the integral of the linear interpolation over the pixel.
_BESIDE, _WITHIN = 1 / 8, 6 / 8

# Beyond this share along x, the direction upwards has no clear x axis at right angles to it, and y takes its place.
_MOST_ALONG_X = 0.9


class EnvironmentTables(NamedTuple):
    """The tables, by the names of the kernels' arguments.

    Attributes
    ----------
    arrays : dict of str to array
        Empty for a black environment, from which nothing is drawn.
    width, height : int
        Pixels; 0 for a black one.
    """

    arrays: dict[str, NDArray[np.float32]]
    width: int
    height: int

    def describe(self, view: NDArray[np.void], settings: Any) -> None:
        """Fill what the view, (1,) `structs.VIEW`, says of the environment of a scene.

        The automatic light belongs to the gradient that the environment replaces: it goes out.
        """
        if settings.light.direction is None:
            view["has_sun"] = 0
        front, right = find_axes(view["to_sky"][0].astype(np.float64), settings.environment_rotation)
        view["environment_front"], view["environment_right"] = front, right
        view["environment_strength"] = settings.environment_strength
        view["environment_width"], view["environment_height"] = self.width, self.height
        if self.width == 0 or settings.environment_strength == 0:
            # A gradient from black to black.
            view["environment_width"] = view["environment_height"] = 0
            view["background_top"] = view["background_bottom"] = 0.0


def find_axes(up: NDArray[np.float64], rotation: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two (3,) float64 unit vectors: to the middle column of the environment, and to the right of it.

    The middle is along +x, as in Blender and three.js, at a right angle to the direction upwards; along +y where that
    is nearly x. The rotation is in degrees, counter-clockwise seen from above.
    """
    axis = np.array([0.0, 1.0, 0.0] if abs(up[0]) > _MOST_ALONG_X else [1.0, 0.0, 0.0])
    front = axis - (axis @ up) * up
    front /= np.linalg.norm(front)
    left = np.cross(up, front)
    angle = np.radians(rotation)
    return np.cos(angle) * front + np.sin(angle) * left, np.sin(angle) * front - np.cos(angle) * left


def make_environment_tables(pixels: NDArray[np.float32]) -> EnvironmentTables:
    """Return the tables of a panorama.

    Pixels are drawn in proportion to the luminance of the light that is interpolated within them, times their solid
    angle: then a dark pixel beside a bright one is drawn for the light that it gets from there.

    Parameters
    ----------
    pixels : (h, w, 3) float32, linear, 0 or more
    """
    height, width, _ = pixels.shape
    light = pixels.astype(np.float64) @ LUMINANCE
    light = _WITHIN * light + _BESIDE * (np.roll(light, 1, axis=1) + np.roll(light, -1, axis=1))
    rows = np.r_[0, np.arange(height), height - 1]
    light = _WITHIN * light + _BESIDE * (light[rows[:-2]] + light[rows[2:]])
    light *= solid_angles(width, height)[:, None]
    columns = np.cumsum(light, axis=1)
    row_light = columns[:, -1].copy()
    total = np.cumsum(row_light)
    if not total[-1] > 0:
        return EnvironmentTables({}, 0, 0)
    # A black row is never drawn, but its sums end with 1, as all do.
    columns[row_light == 0] = np.arange(1, width + 1)
    columns /= columns[:, -1:]
    arrays: dict[str, Any] = {
        "environment": np.ascontiguousarray(pixels, np.float32),
        "environment_rows": (total / total[-1]).astype(np.float32),
        "environment_columns": columns.astype(np.float32),
    }
    return EnvironmentTables(arrays, width, height)


def solid_angles(width: int, height: int) -> NDArray[np.float64]:
    """Return (height,) float64: the solid angle of one pixel of each row."""
    latitudes = np.pi / height * np.arange(height + 1)
    # cos a - cos b, without cancellation near the poles.
    middles, half_row = (latitudes[1:] + latitudes[:-1]) / 2, np.pi / (2 * height)
    return 4 * np.pi / width * np.sin(middles) * np.sin(half_row)

"""How the points of a picture become rays, and points in space become points of the picture: one class per projection.

In the camera's frame: x along right, y along up and z along forward, from the eye, in the scene's units. A point of the
picture, `film`, has x to the right and y upwards, each from -1 to 1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .lens import Coefficients, Lens, Window, distort, undistort, upwards, window_of
from .projection import Fisheye, Orthographic, Projection

_Array = NDArray[np.float64]

# Distorted points count as seen if the way back leads to them within this share.
_ROUND_TRIP = 1e-9


class RayModel(ABC):
    """The rays of a picture; arrays of coordinates broadcast against each other."""

    def offsets(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any] | None:
        """Return where rays begin, to the right and upwards of the eye; None: in the eye."""
        return None

    @abstractmethod
    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions, of any length."""

    def sees(self, film_x: _Array, film_y: _Array) -> Any:
        """Return whether there is anything to see at a point of the picture."""
        return True

    @abstractmethod
    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear; NaN where they do not."""


@dataclass(frozen=True)
class PinholeModel(RayModel):
    """Perspective, with the distortion of a lens or without; `distortion` has y upwards."""

    window: Window
    distortion: Coefficients | None = None

    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions."""
        x, y = self.window.points(film_x, film_y)
        if self.distortion is not None:
            x, y = np.broadcast_arrays(x, y)
            x, y = undistort(x, y, self.distortion)
        return x, y, 1.0

    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear."""
        is_ahead = z > 0
        depth = np.where(is_ahead, z, np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            u, v = x / depth, y / depth
            if self.distortion is None:
                return self.window.film(u, v)
            shown = distort(u, v, self.distortion)
            # Beyond its fold the model would show points again, on top of others.
            back = undistort(*shown, self.distortion)
            off = np.hypot(back[0] - u, back[1] - v)
            is_seen = off <= _ROUND_TRIP * np.maximum(1.0, np.hypot(u, v))
        return self.window.film(np.where(is_seen, shown[0], np.nan), np.where(is_seen, shown[1], np.nan))


@dataclass(frozen=True)
class ParallelModel(RayModel):
    """Orthographic: parallel rays from a rectangle, half of whose sides these are, in the scene's units."""

    half_width: float
    half_height: float

    def offsets(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any]:
        """Return where rays begin."""
        return film_x * self.half_width, film_y * self.half_height

    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions."""
        zero = np.zeros(np.broadcast_shapes(film_x.shape, film_y.shape))
        return zero, zero, 1.0

    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear."""
        is_ahead = z >= 0
        with np.errstate(over="ignore"):
            across, upwards = x / self.half_width, y / self.half_height
        return np.where(is_ahead, across, np.nan), np.where(is_ahead, upwards, np.nan)


@dataclass(frozen=True)
class FisheyeModel(RayModel):
    """Equidistant: the angle to the axis is `half_angle`, in radians, times the distance from the middle.

    The sides of the picture in that unit are twice `half_width` and `half_height`.
    """

    half_width: float
    half_height: float
    half_angle: float

    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions."""
        x, y = film_x * self.half_width, film_y * self.half_height
        radius = np.hypot(x, y)
        # Outside the circle, where nothing is seen, any direction will do.
        angle = np.minimum(radius, 1.0) * self.half_angle
        slope = np.sin(angle) / np.where(radius > 0, radius, 1.0)
        return slope * x, slope * y, np.cos(angle)

    def sees(self, film_x: _Array, film_y: _Array) -> Any:
        """Return what is inside the circle."""
        return np.hypot(film_x * self.half_width, film_y * self.half_height) <= 1

    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear."""
        aside = np.hypot(x, y)
        angle = np.arctan2(aside, z)
        is_seen = (angle <= self.half_angle) & ((aside > 0) | (z != 0))
        radius = np.where(is_seen, angle, np.nan) / self.half_angle
        # Straight behind the camera is all of the circle: to the right.
        cosine, sine = np.where(aside > 0, x, 1.0), np.where(aside > 0, y, 0.0)
        length = np.where(aside > 0, aside, 1.0)
        return radius * (cosine / length) / self.half_width, radius * (sine / length) / self.half_height


@dataclass(frozen=True)
class PanoramaModel(RayModel):
    """Equirectangular: x is the longitude and y the latitude."""

    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions."""
        longitude, latitude = film_x * math.pi, film_y * (math.pi / 2)
        level = np.cos(latitude)
        return np.sin(longitude) * level, np.sin(latitude), np.cos(longitude) * level

    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear."""
        level = np.hypot(x, z)
        is_seen = (level > 0) | (y != 0)
        longitude, latitude = np.arctan2(x, z), np.arctan2(y, level)
        return np.where(is_seen, longitude, np.nan) / math.pi, np.where(is_seen, latitude, np.nan) / (math.pi / 2)


def make_rays(
    axes: tuple[_Array, _Array, _Array], eye: _Array, model: RayModel, film_x: _Array, film_y: _Array
) -> tuple[_Array, _Array]:
    """Return the origins and directions, (..., 3) float64, of rays through points of the picture, which broadcast.

    `axes` are right, up and forward of the camera, in the scene's coordinates, as are `eye` and the result. Directions
    have length 1.
    """
    right, up, forward = axes
    x, y, z = (_as_columns(part) for part in model.directions(film_x, film_y))
    directions = z * forward + x * right + y * up
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    offsets = model.offsets(film_x, film_y)
    if offsets is None:
        return np.broadcast_to(eye, directions.shape), directions
    across, upwards_of_eye = map(_as_columns, offsets)
    return eye + across * right + upwards_of_eye * up, directions


def pixel_centres_of(width: int, height: int, rows: range) -> tuple[_Array, _Array]:
    """Return the centres of pixels as points of the picture: x of all columns, (1, width), and y, (rows, 1)."""
    x = (2 * np.arange(width) + 1) / width - 1
    y = 1 - (2 * np.asarray(rows, np.int64) + 1) / height
    return x[None, :], y[:, None]


def find_ray_model(projection: Projection | None, lens: Lens | None, fov: float, width: int, height: int) -> RayModel:
    """Return how the points of a picture of this size become rays; `fov` is that of a camera without a lens."""
    match projection:
        case None if lens is not None:
            distortion = None if lens.distortion is None else upwards(lens.distortion)
            return PinholeModel(window_of(lens.resized(width, height)), distortion)
        case None:
            half_height = math.tan(math.radians(fov) / 2)
            return PinholeModel(Window(0.0, 0.0, half_height * width / height, half_height, 0.0))
        case Orthographic(size):
            half_height = (size or 0.0) / 2
            return ParallelModel(half_height * width / height, half_height)
        case Fisheye(angle):
            shorter = min(width, height)
            return FisheyeModel(width / shorter, height / shorter, math.radians(angle) / 2)
    return PanoramaModel()


def _as_columns(values: Any) -> NDArray[np.float64]:
    """Return coordinates with one more axis, along which vectors lie."""
    return np.asarray(values, np.float64)[..., None]

"""How the points of a picture become rays, and points in space become points of the picture.

In the camera's frame: x along right, y along up and z along forward, from the eye, in the scene's units. A point of the
picture, `film`, has x to the right and y upwards, each from -1 to 1. Each projection has a plane, to which a `Window`
leads, and a map from there to directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .lens import Coefficients, Lens, Window, distort, is_near, undistort, upwards, window_of
from .projection import Fisheye, Orthographic, Panorama, Projection

_Array = NDArray[np.float64]

# Distorted points count as seen if the way back leads to them within this share.
_ROUND_TRIP = 1e-9


@dataclass(frozen=True)
class RayModel:
    """The rays of a picture; arrays of coordinates broadcast against each other.

    Attributes
    ----------
    projection : Orthographic, Fisheye, Panorama or None
    window : Window
        To the plane at distance 1 for perspective, and through the eye for an orthographic camera; to the middle of a
        fisheye's circle of radius 1; to the longitude and latitude of a panorama.
    distortion : Coefficients or None
        With y upwards.
    """

    projection: Projection | None
    window: Window
    distortion: Coefficients | None = None

    def directions(self, film_x: _Array, film_y: _Array) -> tuple[Any, Any, Any]:
        """Return the directions, of any length."""
        x, y = self.window.points(film_x, film_y)
        match self.projection:
            case None if self.distortion is not None:
                return *undistort(x, y, self.distortion), 1.0
            case None:
                return x, y, 1.0
            case Orthographic():
                return np.zeros_like(x), np.zeros_like(y), 1.0
            case Fisheye(degrees):
                radius = np.hypot(x, y)
                # Outside the circle, where nothing is seen, any direction will do.
                angle = np.minimum(radius, 1.0) * (math.radians(degrees) / 2)
                slope = np.sin(angle) / np.where(radius > 0, radius, 1.0)
                return slope * x, slope * y, np.cos(angle)
            case Panorama():
                level = np.cos(y)
                return np.sin(x) * level, np.sin(y), np.cos(x) * level

    def sees(self, film_x: _Array, film_y: _Array) -> Any:
        """Return whether there is anything to see at a point of the picture."""
        return not isinstance(self.projection, Fisheye) or np.hypot(*self.window.points(film_x, film_y)) <= 1

    def film(self, x: _Array, y: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return where points appear; NaN where they do not."""
        is_seen: Any = True
        with np.errstate(over="ignore", invalid="ignore"):
            match self.projection:
                case None:
                    depth = np.where(z > 0, z, np.nan)
                    x, y = x / depth, y / depth
                    if self.distortion is not None:
                        shown = distort(x, y, self.distortion)
                        # Beyond its fold the model would show points again, on top of others.
                        is_seen = is_near(undistort(*shown, self.distortion), (x, y), _ROUND_TRIP)
                        x, y = shown
                case Orthographic():
                    is_seen = z >= 0
                case Fisheye(degrees):
                    aside, half_angle = np.hypot(x, y), math.radians(degrees) / 2
                    angle = np.arctan2(aside, z)
                    is_seen = (angle <= half_angle) & ((aside > 0) | (z != 0))
                    radius, length = angle / half_angle, np.where(aside > 0, aside, 1.0)
                    # Straight behind the camera is all of the circle: to the right.
                    x, y = (
                        radius * (np.where(aside > 0, x, 1.0) / length),
                        radius * (np.where(aside > 0, y, 0.0) / length),
                    )
                case Panorama():
                    level = np.hypot(x, z)
                    is_seen = (level > 0) | (y != 0)
                    x, y = np.arctan2(x, z), np.arctan2(y, level)
            return self.window.film(np.where(is_seen, x, np.nan), np.where(is_seen, y, np.nan))


@lru_cache(maxsize=64)
def find_ray_model(projection: Projection | None, lens: Lens | None, fov: float, width: int, height: int) -> RayModel:
    """Return how the points of a picture of this size become rays; `fov` is that of a camera without a lens."""
    if lens is not None:
        distortion = None if lens.distortion is None else upwards(lens.distortion)
        return RayModel(None, window_of(lens.resized(width, height)), distortion)
    match projection:
        case Fisheye():
            shorter = min(width, height)
            return RayModel(projection, Window(width / shorter, height / shorter))
        case Panorama():
            return RayModel(projection, Window(math.pi, math.pi / 2))
        case Orthographic(size):
            half_height = (size or 0.0) / 2
        case None:
            half_height = math.tan(math.radians(fov) / 2)
    return RayModel(projection, Window(half_height * width / height, half_height))


def pixel_centres_of(width: int, height: int, rows: range) -> tuple[_Array, _Array]:
    """Return the centres of pixels as points of the picture: x of all columns, (1, width), and y, (rows, 1)."""
    x = (2 * np.arange(width) + 1) / width - 1
    y = 1 - (2 * np.asarray(rows, np.int64) + 1) / height
    return x[None, :], y[:, None]

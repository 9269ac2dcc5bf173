"""The rays of a camera: those of its projection, placed in the scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .distortion import upwards
from .lens import window_of
from .projection import Fisheye, Orthographic, Panorama
from .ray_model import FisheyeModel, PanoramaModel, ParallelModel, PinholeModel, RayModel
from .window import Window

if TYPE_CHECKING:
    from .camera import Camera

_Array = NDArray[np.float64]


def make_rays(camera: Camera, model: RayModel, film_x: _Array, film_y: _Array) -> tuple[_Array, _Array]:
    """Return the rays through points of the picture, whose coordinates broadcast against each other.

    Parameters
    ----------
    camera : Camera
    model : RayModel
        Of a picture of the camera.
    film_x, film_y : float64
        To the right and upwards, from -1 to 1.

    Returns
    -------
    origins, directions : (..., 3) float64
        In the scene's coordinates; directions of length 1.
    """
    right, up, forward = camera.axes()
    x, y, z = (_as_columns(part) for part in model.directions(film_x, film_y))
    directions = z * forward + x * right + y * up
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    offsets = model.offsets(film_x, film_y)
    eye = np.asarray(camera.eye, np.float64)
    if offsets is None:
        return np.broadcast_to(eye, directions.shape), directions
    across, upwards_of_eye = map(_as_columns, offsets)
    return eye + across * right + upwards_of_eye * up, directions


def pixel_centres_of(width: int, height: int, rows: range) -> tuple[_Array, _Array]:
    """Return the centres of pixels as points of the picture: x of all columns, (1, width), and y, (rows, 1)."""
    x = (2 * np.arange(width) + 1) / width - 1
    y = 1 - (2 * np.asarray(rows, np.int64) + 1) / height
    return x[None, :], y[:, None]


def find_window(camera: Camera, width: int, height: int) -> Window:
    """Return the window of a picture of this size in the plane at distance 1 from the eye."""
    if camera.lens is not None:
        return window_of(camera.lens.resized(width, height))
    half_height = math.tan(math.radians(camera.fov) / 2)
    return Window(0.0, 0.0, half_height * width / height, half_height, 0.0)


def find_ray_model(camera: Camera, width: int, height: int) -> RayModel:
    """Return how the points of a picture of this size become rays."""
    match camera.projection:
        case None:
            distortion = None if camera.lens is None else camera.lens.distortion
            window = find_window(camera, width, height)
            return PinholeModel(window, None if distortion is None else upwards(distortion))
        case Orthographic(size):
            half_height = (size or 0.0) / 2
            return ParallelModel(half_height * width / height, half_height)
        case Fisheye(angle):
            shorter = min(width, height)
            return FisheyeModel(width / shorter, height / shorter, math.radians(angle) / 2)
        case Panorama():
            return PanoramaModel()


def _as_columns(values: Any) -> NDArray[np.float64]:
    """Return coordinates with one more axis, along which vectors lie."""
    return np.asarray(values, np.float64)[..., None]

"""The projection of a camera in the form that kernels take: a part of one `structs.VIEW`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..structs import PROJECTIONS
from .camera import Camera
from .camera_rays import find_ray_model, find_window
from .projection import name_of
from .ray_model import FisheyeModel, ParallelModel, PinholeModel

# Largest extent of a lens or of parallel rays, in sizes of the mesh: well within float32.
_MOST_EXTENT = 1e30

_Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def set_projection(view: NDArray[np.void], camera: Camera, scale: float, width: int, height: int) -> None:
    """Write the fields of the projection and of the lens into a view.

    Parameters
    ----------
    view : (1,) `structs.VIEW`
    camera : Camera
    scale : float
        Local units in one unit of the scene.
    width, height : int, pixels

    Raises
    ------
    SceneError
        A length is too large for float32, or the aspect ratio is not that of the camera's lens.
    """
    model = find_ray_model(camera, width, height)
    right, up, middle = axes = camera.axes()
    kind = name_of(camera.projection)
    match model:
        case PinholeModel(_, None):
            middle, right, up = _span_picture(camera, width, height, axes)
        case PinholeModel(window, distortion):
            kind = "distorted"
            view["centre"] = window.centre_x, window.centre_y
            view["half_size"] = window.half_width, window.half_height
            view["shear"] = window.shear
            view["distortion"] = distortion
        case ParallelModel(half_width, half_height):
            right, up = half_width * scale * right, half_height * scale * up
        case FisheyeModel(half_width, half_height, half_angle):
            view["half_size"] = half_width, half_height
            view["half_angle"] = half_angle / (2 * math.pi)
    view["projection"] = PROJECTIONS[kind]
    view["forward"] = middle
    view["forward_low"] = middle - view["forward"]
    view["right"], view["up"] = right, up
    _set_lens(view, camera, scale, axes)
    extents = [np.abs(view[name]).max() for name in ("right", "up", "lens_right", "lens_up")]
    if not max(extents) < _MOST_EXTENT:
        raise SceneError(f"the camera's height or aperture is more than {_MOST_EXTENT:.0e} sizes of the mesh")


def _set_lens(view: NDArray[np.void], camera: Camera, scale: float, axes: _Axes) -> None:
    """Write the fields of depth of field."""
    radius = camera.aperture / 2 * scale
    if radius == 0:
        return
    view["has_lens"] = 1
    with np.errstate(over="ignore"):  # refused by `set_projection`
        view["lens_right"], view["lens_up"] = radius * axes[0], radius * axes[1]
        view["inverse_focus"] = 1 / (camera.focus * scale)


def _span_picture(camera: Camera, width: int, height: int, axes: _Axes) -> _Axes:
    """Return the middle of the picture in the plane at distance 1 from the eye, and its halves right and up."""
    right, up, forward = axes
    if camera.lens is None:
        half_height = math.tan(math.radians(camera.fov) / 2)
        # The order of these products determines the last bits of pictures.
        return forward, right * half_height * width / height, up * half_height
    window = find_window(camera, width, height)
    # One unit upwards, which skew also moves to the side.
    upwards = up + window.shear * right
    middle = forward + window.centre_x * right + window.centre_y * upwards
    return middle, window.half_width * right, window.half_height * upwards

"""How a camera moves when somebody drags, turns a wheel or flies: values in, values out.

Every function returns a camera of which `tidy` has rounded the numbers, so that the command that shows the same picture
stays short.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..support.settings import Vector
from ..views.cameras.arrays import as_vector
from ..views.cameras.camera import Camera
from ..views.cameras.projection import Fisheye, Orthographic, Panorama

# Degrees by which the line of sight stays away from up and down, where the picture would flip over.
_POLE = 0.5

# Digits of a coordinate, counted from the height of what is seen, or the distance if that is less: a thousandth of a
# pixel.
_DIGITS = 7

_Array = NDArray[np.float64]


def tidy(camera: Camera) -> Camera:
    """Return the camera with coordinates of a few digits; one with a lens, for which there is no command, as it is."""
    if camera.lens is not None:
        return camera  # its look_at may be anywhere on its axis
    projection, height = camera.projection, math.dist(camera.eye, camera.look_at)
    if isinstance(projection, Orthographic):
        assert projection.height is not None
        height = min(height, projection.height)
        projection = Orthographic(float(f"{projection.height:.{_DIGITS}g}"))
    elif projection is None:
        height *= min(1.0, 2 * math.tan(math.radians(camera.fov) / 2))
    digits = _DIGITS - 1 - math.floor(math.log10(height))
    eye, look_at = (as_vector(np.round(point, digits)) for point in (camera.eye, camera.look_at))
    return replace(camera, eye=eye, look_at=look_at, projection=projection)


def turn(camera: Camera, degrees: tuple[float, float], about: Vector, up: Vector) -> Camera:
    """Return the camera after a turn about a point: to the right around `up`, and upwards; the horizon stays level."""
    _, _, forward = camera.axes()
    upward = np.asarray(up, np.float64) / np.linalg.norm(up)
    elevation = math.degrees(math.asin(float(np.clip(-forward @ upward, -1.0, 1.0))))
    limit = 90.0 - _POLE
    rise = min(max(elevation + degrees[1], -limit), limit) - elevation
    turned = camera.orbit(degrees[0], about=about, axis=up)
    # About the axis to the right, a positive turn lowers the camera.
    return tidy(replace(turned.orbit(-rise, about=about, axis=as_vector(turned.axes()[0])), up=up))


def move(camera: Camera, by: ArrayLike) -> Camera:
    """Return the camera moved by a vector."""
    eye, look_at = (as_vector(np.add(point, by)) for point in (camera.eye, camera.look_at))
    return tidy(replace(camera, eye=eye, look_at=look_at))


def drag(camera: Camera, point: Vector, pixel: ArrayLike, size: tuple[int, int]) -> Camera:
    """Return the camera moved across its line of sight, so that a point appears at a pixel; in any projection."""
    return move(camera, _offset(camera, point, pixel, size))


def zoom(camera: Camera, factor: float, towards: Vector, pixel: ArrayLike, size: tuple[int, int]) -> Camera:
    """Return the camera at another distance of a point, which stays at its pixel; of parallel rays, the height."""
    if isinstance(camera.projection, Orthographic):
        assert camera.projection.height is not None
        closer = replace(camera, projection=Orthographic(camera.projection.height * factor))
        return drag(closer, towards, pixel, size)
    eye, look_at = (
        as_vector(np.add(towards, np.subtract(at, towards) * factor)) for at in (camera.eye, camera.look_at)
    )
    return tidy(replace(camera, eye=eye, look_at=look_at))


def focus(camera: Camera, point: Vector, share: float) -> Camera:
    """Return the camera that has a point in the middle, at a share of its distance."""
    forward = camera.axes()[2]
    depth = abs(float(np.subtract(point, camera.eye) @ forward)) or math.dist(camera.eye, camera.look_at)
    eye = as_vector(np.subtract(point, forward * depth * share))
    return tidy(replace(camera, eye=eye, look_at=as_vector(point)))


def find_opposite(camera: Camera, pixel: ArrayLike, size: tuple[int, int]) -> Vector:
    """Return the point of the ray through a pixel at the depth, or the distance, of `look_at`."""
    return as_vector(np.subtract(camera.look_at, _offset(camera, camera.look_at, pixel, size)))


def _offset(camera: Camera, point: Vector, pixel: ArrayLike, size: tuple[int, int]) -> _Array:
    """Return how far a point is beside the ray through a pixel, across the line of sight."""
    origin, direction = camera.rays_at(pixel, *size)
    off = np.subtract(point, origin)
    if isinstance(camera.projection, Fisheye | Panorama):  # by its distance: at the side of the camera, depth is 0
        return off - direction * np.linalg.norm(off)
    forward = camera.axes()[2]
    return off - direction * ((off @ forward) / (direction @ forward))

"""Poses of cameras: axes, matrices in the conventions of other programs, and the standard views."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...choices import STANDARD_VIEWS
from ...errors import SceneError
from ...support.settings import Vector, one_of
from .arrays import as_vector, read_array, show_matrix

CONVENTIONS = {"opencv": (1.0, -1.0, 1.0), "opengl": (1.0, 1.0, -1.0)}

# Largest difference of an entry of R^T R from the identity: poses in text files have four digits or more.
_RIGID_SLACK = 1e-4

# Least sine of the angle between up and the line of sight.
_LEAST_SINE = 1e-9

_Array = NDArray[np.float64]


def read_pose(camera_to_world: ArrayLike, convention: str) -> tuple[_Array, _Array, _Array]:
    """Return up, forward and the eye of a pose, each (3,) float64.

    Raises
    ------
    SceneError
        The matrix is not a rotation and a translation, or the convention is unknown.
    """
    signs = find_signs(convention)
    pose = read_array("the camera's pose (camera_to_world)", camera_to_world, (4, 4))
    if not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise SceneError(
            f"the camera's pose (camera_to_world) must have the last row [0, 0, 0, 1], not {show_matrix(pose[3:])}"
        )
    rotation = pose[:3, :3]
    with np.errstate(over="ignore"):
        off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if not off <= _RIGID_SLACK:
        raise SceneError(
            "the camera's pose (camera_to_world) must be rigid, a rotation and a translation, and its axes are not at "
            f"right angles or not of length 1: {show_matrix(rotation)}; take its scale out first"
        )
    if np.linalg.det(rotation) < 0:
        raise SceneError(
            "the camera's pose (camera_to_world) mirrors: its axes are left-handed, and a camera's are right-handed; "
            f"turn one axis around, and see `convention`: {show_matrix(rotation)}"
        )
    # The nearest rotation: Higham, "Computing the polar decomposition", 1986.
    left, _, rows = np.linalg.svd(rotation)
    _, up, forward = (left @ rows * signs).T
    return up, forward, pose[:3, 3].copy()


def make_axes(forward: _Array, up: _Array) -> tuple[_Array, _Array, _Array]:
    """Return right, up and forward as unit vectors at right angles; raise `SceneError` if two are parallel."""
    longest = np.abs(forward).max()
    if not np.isfinite(longest):
        raise SceneError("the camera's eye and look_at are farther apart than float64 can hold")
    if not longest > 0:
        raise SceneError("the camera's eye and look_at are the same point")
    forward = normalise(forward)
    with np.errstate(invalid="ignore"):  # refused by name
        right = np.cross(forward, normalise(up))
    length = np.linalg.norm(right)
    if not length > _LEAST_SINE:
        raise SceneError("the camera's up is zero or parallel to its line of sight")
    right = right / length
    return right, np.cross(right, forward), forward


def normalise(vector: _Array) -> _Array:
    """Return a vector at length 1; NaN for zero."""
    # Scaled first: the squares of a short or long vector need not be in float64.
    vector = vector / np.abs(vector).max()
    return vector / np.linalg.norm(vector)


def rotate_about_axis(axis: _Array, angle: float) -> NDArray[np.float64]:
    """Return the right-handed rotation about an axis of any length above 0, (3, 3) float64; the angle in radians."""
    x, y, z = normalise(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula.
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)


def find_signs(convention: str) -> _Array:
    """Return the signs of right, up and forward in the first three columns of a pose."""
    return np.array(CONVENTIONS[one_of(CONVENTIONS).take("the convention", convention)])


# Degrees to the right of the front, and above the level. The automatic view is from the front, a little from the right
# and from above; in the isometric one the three axes have equal lengths.
_AUTOMATIC = 30.0, 18.0
_ISOMETRIC = 45.0, math.degrees(math.atan(math.sqrt(0.5)))


def find_sides(name: str | None, up: Vector) -> tuple[_Array, Vector]:
    """Return the unit vector towards the camera, and the direction that is up in the picture.

    Parameters
    ----------
    name : str or None
        One of `STANDARD_VIEWS`. None: the automatic view.
    up : (3,) float
        Up in the scene. The front is +z if y is up, and -y if z is up, as in modelling programs. The front is below in
        the view from the top, and above in that from the bottom.

    Raises
    ------
    SceneError
        Another name, or no direction.
    """
    if name is not None:
        one_of(STANDARD_VIEWS).take("the side", name)
    upward = np.asarray(up, np.float64)
    if not np.isfinite(upward).all() or not np.linalg.norm(upward) > 0:
        raise SceneError(f"the camera's up must be a finite direction of length above 0, not {up}")
    upward = upward / np.linalg.norm(upward)
    front = np.array([0.0, 0.0, 1.0]) if abs(upward[2]) < abs(upward[1]) else np.array([0.0, -1.0, 0.0])
    front = front - upward * (front @ upward)
    front /= np.linalg.norm(front)
    right = np.cross(upward, front)
    level_sides = {"front": front, "right": right, "back": -front, "left": -right}
    if name in level_sides:
        return level_sides[name], up
    if name in ("top", "bottom"):
        sign = 1.0 if name == "top" else -1.0
        return sign * upward, as_vector(-sign * front)
    azimuth, elevation = map(math.radians, _AUTOMATIC if name is None else _ISOMETRIC)
    level = math.cos(azimuth) * front + math.sin(azimuth) * right
    return math.cos(elevation) * level + math.sin(elevation) * upward, up

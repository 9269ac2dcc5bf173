"""Cameras that see a whole mesh: from one side, or from all sides during a turn."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from .camera import DEFAULT_FOV, DEFAULT_UP, Camera, check_fov
from .pose import make_axes
from .vectors import Vector, as_vector

# The automatic view: from the front, a little from the right and from above, with a margin around the mesh.
_AZIMUTH_DEGREES = 30.0
_ELEVATION_DEGREES = 18.0
_MARGIN = 0.06

# A mesh without extent still needs a distance; in local units.
_SMALLEST_DISTANCE = 1e-6

# Vertices per step when the mesh is framed: 10 MB at a time.
_CHUNK_VERTICES = 2**17


def frame_mesh(
    mesh: Mesh,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view, as close as possible.

    Parameters
    ----------
    mesh : Mesh
    aspect : float
        Width of the picture divided by its height.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    eye : (3,) float, optional
        A fixed position; the camera looks at the middle of the mesh's box.

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_x, eye_y and eye_z in closed form.
    """
    check_fov(fov)
    if eye is not None:
        return Camera(eye, as_vector(mesh.origin), up, fov)
    view = _View.from_three_quarters(aspect, up, fov)
    bounds = _Bounds()
    for points in _chunks(mesh):
        depth = points @ view.forward
        offset = points @ view.across
        bounds.include(
            (offset - depth[:, None] * view.tangents).max(axis=0),
            (offset + depth[:, None] * view.tangents).min(axis=0),
            depth.min(),
            depth.max(),
        )
    distance = bounds.eye_distance(view)
    local_eye = view.across @ bounds.centre - distance * view.forward
    local_target = local_eye + view.forward * (distance + (bounds.nearest + bounds.farthest) / 2)
    return _make_camera(mesh, local_eye, local_target, up, fov)


def frame_turn(mesh: Mesh, *, aspect: float, up: Vector = DEFAULT_UP, fov: float = DEFAULT_FOV) -> Camera:
    """Return a camera that sees all of a mesh while it orbits the axis `up` through the middle of the mesh's box.

    Parameters
    ----------
    mesh, aspect, up, fov
        See `frame_mesh`.

    Notes
    -----
    As exact as `frame_mesh`: each point moves on a circle around the axis, and the bounds over a circle of radius r at
    height h are linear in r and h.
    """
    check_fov(fov)
    view = _View.from_three_quarters(aspect, up, fov)
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    # The level direction of sight; a point of a circle is at r (cos right + sin level) + h axis.
    level = view.forward - axis * (axis @ view.forward)
    level /= np.linalg.norm(level)
    level_depth, axis_depth = level @ view.forward, axis @ view.forward
    upward = view.across[:, 1]
    wide, high = view.tangents
    bounds = _Bounds()
    for points in _chunks(mesh):
        height = points @ axis
        radius = np.linalg.norm(points - height[:, None] * axis, axis=1)
        side = radius * math.hypot(1.0, level_depth * wide)
        above = radius * abs(level @ upward - level_depth * high) + height * (axis @ upward - axis_depth * high)
        below = height * (axis @ upward + axis_depth * high) - radius * abs(level @ upward + level_depth * high)
        bounds.include(
            np.array([(side - height * axis_depth * wide).max(), above.max()]),
            np.array([(height * axis_depth * wide - side).min(), below.min()]),
            (height * axis_depth - radius * level_depth).min(),
            (height * axis_depth + radius * level_depth).max(),
        )
    distance = bounds.eye_distance(view)
    local_eye = view.across @ bounds.centre - distance * view.forward
    # Where the line of sight meets the axis.
    local_target = axis * (axis @ (local_eye - view.forward * (local_eye @ level) / level_depth))
    return _make_camera(mesh, local_eye, local_target, up, fov)


def _make_camera(
    mesh: Mesh, local_eye: NDArray[np.float64], local_target: NDArray[np.float64], up: Vector, fov: float
) -> Camera:
    """Return the camera at a point in local coordinates that looks at another one."""
    eye, look_at = (as_vector(mesh.origin + point / mesh.scale) for point in (local_eye, local_target))
    return Camera(eye, look_at, up, fov)


class _View(NamedTuple):
    """A direction of view, and the slopes of the picture's sides, reduced by the margin.

    Attributes
    ----------
    across : (3, 2) float64
        Unit vectors right and up.
    forward : (3,) float64
    tangents : (2,) float64
        Of half the field of view, horizontal and vertical.
    """

    across: NDArray[np.float64]
    forward: NDArray[np.float64]
    tangents: NDArray[np.float64]

    @classmethod
    def from_three_quarters(cls, aspect: float, up: Vector, fov: float) -> _View:
        right, upward, forward = make_axes(-_three_quarter_direction(up), np.asarray(up, np.float64))
        tangents = np.array([aspect, 1.0]) * math.tan(math.radians(fov) / 2) * (1 - _MARGIN)
        return cls(np.stack([right, upward], axis=1), forward, tangents)


class _Bounds:
    """The planes of a view's four sides, moved inwards until they touch the points, and the depths of the points.

    In local coordinates; the horizontal planes first.
    """

    def __init__(self) -> None:
        self.highest, self.lowest = np.full(2, -np.inf), np.full(2, np.inf)
        self.nearest, self.farthest = np.inf, -np.inf

    def include(
        self, highest: NDArray[np.float64], lowest: NDArray[np.float64], nearest: float, farthest: float
    ) -> None:
        """Widen the bounds by those of more points."""
        self.highest, self.lowest = np.maximum(self.highest, highest), np.minimum(self.lowest, lowest)
        self.nearest, self.farthest = min(self.nearest, nearest), max(self.farthest, farthest)

    @property
    def centre(self) -> NDArray[np.float64]:
        """(2,) float64: the line of sight, to the right and upwards."""
        return (self.highest + self.lowest) / 2

    def eye_distance(self, view: _View) -> float:
        """Return the distance from the eye to the plane of depth 0."""
        distance = float(((self.highest - self.lowest) / (2 * view.tangents)).max())
        size = max(self.farthest - self.nearest, float((self.highest - self.lowest).max()), _SMALLEST_DISTANCE)
        # A flat mesh seen edge-on touches no side, and no point may lie behind the eye.
        return max(distance, -self.nearest + 1e-3 * size)


def _chunks(mesh: Mesh) -> Iterator[NDArray[np.float64]]:
    """Yield the local vertices in chunks."""
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        yield mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)


def _three_quarter_direction(up: Vector) -> NDArray[np.float64]:
    """Return the unit vector from the mesh towards the camera."""
    upward = np.asarray(up, np.float64)
    if not np.isfinite(upward).all() or not np.linalg.norm(upward) > 0:
        raise SceneError(f"the camera's up must be a finite direction of length above 0, not {up}")
    upward = upward / np.linalg.norm(upward)
    # The front is +z if y is up, and -y if z is up, as in modelling programs.
    front = np.array([0.0, 0.0, 1.0]) if abs(upward[2]) < abs(upward[1]) else np.array([0.0, -1.0, 0.0])
    front = front - upward * (front @ upward)
    front /= np.linalg.norm(front)
    side = np.cross(upward, front)
    azimuth, elevation = math.radians(_AZIMUTH_DEGREES), math.radians(_ELEVATION_DEGREES)
    level = math.cos(azimuth) * front + math.sin(azimuth) * side
    return math.cos(elevation) * level + math.sin(elevation) * upward

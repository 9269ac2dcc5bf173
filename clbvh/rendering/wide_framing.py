"""Cameras of other projections than perspective that see a whole mesh or scene."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from .camera import DEFAULT_FOV, Camera
from .extent_bounds import find_bounds
from .pose import make_axes
from .projection import Fisheye, Orthographic, Panorama, Projection
from .scene_extent import SceneExtent
from .standard_views import find_sides
from .vectors import Vector, as_vector
from .view_bounds import MARGIN, SMALLEST_DISTANCE, Turn, View, ViewBounds

# A wide fisheye sees everything from close by, but most of it at the side of its picture: it stands so far away that
# the mesh takes up to half of its circle.
_WIDEST_HALF_ANGLE = math.radians(45)

_Vector = NDArray[np.float64]


def frame_wide(
    mesh: Mesh | SceneExtent,
    projection: Projection,
    *,
    aspect: float,
    up: Vector,
    eye: Vector | None = None,
    side: str | None = None,
) -> Camera:
    """Return a camera of this projection that sees all of a mesh; see `frame_mesh`.

    Notes
    -----
    An orthographic camera is exact: without a height it gets the least one, with one the mesh is in the middle. A
    fisheye sees the ball around the mesh's box. A panorama stands in the middle of the box and looks level.

    Raises
    ------
    SceneError
        For a panorama from the top or from the bottom.
    """
    if eye is not None:
        return look_from(mesh, projection, eye, as_vector(mesh.origin), aspect=aspect, up=up)
    if isinstance(projection, Panorama) and side in ("top", "bottom"):
        raise SceneError(f"a panorama sees all sides at once, and looks level: take another view than '{side}'")
    view = View.from_side(side, aspect, up, DEFAULT_FOV)
    match projection:
        case Orthographic():
            view = view._replace(tangents=np.zeros(2))
            bounds = find_bounds(view, mesh)
            size = _size_of(bounds)
            local_eye = view.across @ bounds.middle + view.forward * (bounds.nearest - size)
            local_target = local_eye + view.forward * (size + (bounds.farthest - bounds.nearest) / 2)
            half = np.abs(bounds.highest - bounds.lowest) / 2
            projection = _with_height(projection, half, aspect, mesh.scale)
        case Fisheye():
            local_target = np.zeros(3)
            local_eye = local_target - view.forward * _distance_of_ball(mesh, projection)
        case Panorama():
            local_eye = np.zeros(3)
            local_target = _level(view.forward, up)
    return _make_camera(mesh, local_eye, local_target, find_sides(side, up)[1], projection)


def frame_wide_turn(mesh: Mesh | SceneExtent, projection: Projection, *, aspect: float, up: Vector) -> Camera:
    """Return a camera of this projection that sees all of a mesh while it orbits; see `frame_turn`.

    Raises
    ------
    SceneError
        For a panorama, which sees all sides at once.
    """
    if isinstance(projection, Panorama):
        raise SceneError("a panorama sees all sides at once and has no turn: take another projection")
    if isinstance(projection, Fisheye):
        return frame_wide(mesh, projection, aspect=aspect, up=up)
    turn = Turn.from_three_quarters(aspect, up, DEFAULT_FOV)
    view = turn.view._replace(tangents=np.zeros(2))
    turn = turn._replace(view=view)
    bounds = find_bounds(turn, mesh)
    # On the axis, at the height of the middle of the picture.
    local_target = turn.axis * (bounds.middle[1] / (turn.axis @ view.across[:, 1]))
    local_eye = local_target + view.forward * (bounds.nearest - _size_of(bounds) - local_target @ view.forward)
    half = np.abs(bounds.highest - bounds.lowest) / 2
    return _make_camera(mesh, local_eye, local_target, up, _with_height(projection, half, aspect, mesh.scale))


def look_from(
    mesh: Mesh | SceneExtent, projection: Projection, eye: Vector, look_at: Vector, *, aspect: float, up: Vector
) -> Camera:
    """Return the camera at a fixed position; an orthographic one without a height sees all of the mesh beside it."""
    if projection != Orthographic():
        return Camera(eye, look_at, up, projection=projection)
    right, upward, forward = make_axes(np.subtract(look_at, eye), np.asarray(up, np.float64))
    view = View(np.stack([right, upward], axis=1), forward, np.zeros(2))
    bounds = find_bounds(view, mesh)
    centre = ((np.asarray(eye, np.float64) - mesh.origin) * mesh.scale) @ view.across
    half = np.maximum(bounds.highest - centre, centre - bounds.lowest)
    return Camera(eye, look_at, up, projection=_with_height(Orthographic(), half, aspect, mesh.scale))


def _with_height(projection: Orthographic, half: _Vector, aspect: float, scale: float) -> Orthographic:
    """Return the projection, with a height for these halves of what is seen, in local units, if it has none."""
    if projection.height is not None:
        return projection
    half_height = max(half[1], half[0] / aspect, SMALLEST_DISTANCE) / (1 - MARGIN)
    return replace(projection, height=float(2 * half_height / scale))


def _size_of(bounds: ViewBounds) -> float:
    sides = (bounds.farthest - bounds.nearest, *(bounds.highest - bounds.lowest), SMALLEST_DISTANCE)
    return float(max(sides))


def _distance_of_ball(mesh: Mesh | SceneExtent, projection: Fisheye) -> float:
    """Return the distance from which a fisheye sees the ball around the box of a mesh, in local units."""
    radius = max(float(np.linalg.norm(np.abs(mesh.local_box).max(axis=0))), SMALLEST_DISTANCE)
    half_angle = math.radians(projection.angle) / 2 * (1 - MARGIN)
    return radius / math.sin(min(half_angle, _WIDEST_HALF_ANGLE))


def _level(forward: _Vector, up: Vector) -> _Vector:
    """Return a direction of sight without its part along the up direction, as a unit vector."""
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    level = forward - axis * (axis @ forward)
    return level / np.linalg.norm(level)


def _make_camera(
    mesh: Mesh | SceneExtent, local_eye: _Vector, local_target: _Vector, up: Vector, projection: Projection
) -> Camera:
    eye, look_at = (as_vector(mesh.origin + point / mesh.scale) for point in (local_eye, local_target))
    return Camera(eye, look_at, up, projection=projection)

"""Cameras that see a whole mesh or scene: from one side, or from all sides during a turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from .camera import DEFAULT_FOV, DEFAULT_UP, Camera, check_fov
from .pose import find_sides, make_axes
from .projection import Fisheye, Orthographic, Panorama, Projection
from .vectors import Vector, as_vector
from .view_bounds import MARGIN, SMALLEST_DISTANCE, SceneExtent, Turn, View, ViewBounds, find_bounds, find_bounds_of_all


def frame_mesh(
    mesh: Mesh | SceneExtent,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
    projection: Projection | None = None,
    side: str | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view or a standard one, as close as possible.

    Parameters
    ----------
    mesh : Mesh or SceneExtent
        A mesh, or all that a scene holds.
    aspect : float
        Width of the picture divided by its height.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    eye : (3,) float, optional
        A fixed position; the camera looks at the middle of the mesh's box.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. The others have no `fov`; a panorama looks from the middle of the mesh's box.
    side : str, optional
        One of `STANDARD_VIEWS`, in place of the three-quarter view and without an `eye`.

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_z in closed form, and either eye_x or eye_y. The other one is chosen by `find_eye`.
    """
    check_fov(fov)
    if projection is not None:
        return frame_wide(mesh, projection, aspect=aspect, up=up, eye=eye, side=side)
    if eye is not None:
        return Camera(eye, as_vector(mesh.origin), up, fov)
    view = View.from_side(side, aspect, up, fov)
    return _frame(view, mesh, find_sides(side, up)[1], fov)


def measure_side(mesh: Mesh | SceneExtent, side: str | None, up: Vector = DEFAULT_UP) -> tuple[float, float]:
    """Return the width and the height of a mesh as an orthographic picture from a side shows it, in its units."""
    view = View.from_side(side, 1.0, up, DEFAULT_FOV)._replace(tangents=np.zeros(2))
    bounds = find_bounds(view, mesh)
    width, height = ((bounds.highest - bounds.lowest) / mesh.scale).tolist()
    return width, height


def frame_turn(
    mesh: Mesh | SceneExtent,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    projection: Projection | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh while it orbits the axis `up` through the middle of the mesh's box.

    Parameters
    ----------
    mesh, aspect, up, fov, projection
        See `frame_mesh`.

    Raises
    ------
    SceneError
        For a panorama, which sees all sides at once.

    Notes
    -----
    As exact as `frame_mesh`: each point moves on a circle around the axis, and the bounds over a circle of radius r at
    height h are linear in r and h.
    """
    check_fov(fov)
    if projection is not None:
        return frame_wide_turn(mesh, projection, aspect=aspect, up=up)
    turn = Turn.from_three_quarters(aspect, up, fov)
    return _frame(turn, mesh, up, fov)


def _frame(view: View | Turn, mesh: Mesh | SceneExtent, up: Vector, fov: float) -> Camera:
    eye, bounds = find_eye(view, mesh)
    return view.make_camera(eye, bounds, mesh, up, fov)


# The slopes of the picture's sides for which bounds are known, as shares of the whole ones. With four of them, the two
# margins of a tilted plate differ by less than a hundredth of the picture.
_SHARES = (0.0, 1 / 3, 2 / 3, 1.0)


def find_eye(view: View | Turn, mesh: Mesh | SceneExtent) -> tuple[NDArray[np.float64], ViewBounds]:
    """Return the eye of a view that sees all of a mesh, (3,) float64 in local coordinates, and the bounds of the view.

    Notes
    -----
    The tightest pair of sides gives the distance of the eye. Where the other pair leaves room, the eye could stand
    anywhere between them. Halfway is not the middle of the picture: what is near moves more than what is far.
    The eye stands where a narrower picture would see all: for slopes s of its sides, the planes that touch the points
    from above and below meet the plane of the eye in ``highest(s) - s distance`` and ``lowest(s) + s distance``, and s
    is the least for which the first is not above the second. Both are known for a few s, and linear in between;
    as ``highest`` is convex and ``lowest`` concave, no point is left out.
    """
    several = find_bounds_of_all([view.narrowed(share) for share in _SHARES], mesh)
    look = view.view if isinstance(view, Turn) else view
    distance = look.find_distance(several[-1])
    centre = [_find_middle(several, look.tangents[axis] * distance, axis) for axis in range(2)]
    return look.across @ centre - distance * look.forward, several[-1]


def _find_middle(several: Sequence[ViewBounds], reach: float, axis: int) -> float:
    """Return the eye's coordinate along one axis of the picture; `reach` is half the picture's side in depth 0."""
    excesses = [
        float(bounds.highest[axis] - bounds.lowest[axis]) - 2 * share * reach
        for share, bounds in zip(_SHARES, several, strict=True)
    ]
    # The last is 0 along the tightest axis, but for rounding.
    after = next((number for number, excess in enumerate(excesses[:-1]) if excess <= 0), len(_SHARES) - 1)
    if after == 0 or excesses[after] >= 0:
        return float(several[after].middle[axis])
    part = excesses[after - 1] / (excesses[after - 1] - excesses[after])
    before, behind = several[after - 1].middle[axis], several[after].middle[axis]
    return float(before + part * (behind - before))


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

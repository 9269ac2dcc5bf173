"""Cameras that see a whole mesh or scene: from one side, or from all sides during a turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry import Mesh
from ..vectors import Vector, as_vector
from .bounds import MARGIN, SMALLEST_DISTANCE, SceneBounds, View, ViewPlanes, find_bounds, find_bounds_of_all
from .camera import Camera
from .pose import find_sides, make_axes
from .projection import DEFAULT_FOV, DEFAULT_UP, Fisheye, Orthographic, Panorama, Projection, check_fov


def frame_mesh(
    mesh: Mesh | SceneBounds,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
    projection: Projection | None = None,
    side: str | None = None,
    turns: bool = False,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view or a standard one, as close as possible.

    Parameters
    ----------
    mesh : Mesh or SceneBounds
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
    turns : bool
        Whether all is to be seen while the camera orbits the axis `up` through the middle of the mesh's box.

    Raises
    ------
    SceneError
        For a panorama that turns, or looks from the top or the bottom.

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_z in closed form, and either eye_x or eye_y. The other one is chosen by `_find_eye`. A turn is as
    exact: the bounds over the circle of a point are linear in its radius and its height.
    """
    check_fov(fov)
    if eye is not None:
        return look_from(mesh, projection, eye, as_vector(mesh.origin), aspect=aspect, up=up, fov=fov)
    if isinstance(projection, Panorama) and (turns or side in ("top", "bottom")):
        remedy = "has no turn: take another projection" if turns else f"looks level: take another view than '{side}'"
        raise SceneError(f"a panorama sees all sides at once and {remedy}")
    view = View.from_side(side, aspect, up, fov, turns=turns)
    match projection:
        case None:
            local_eye, bounds = _find_eye(view, mesh)
            local_target = view.find_target(local_eye, bounds)
        case Orthographic():
            # Exact, too: without a height it gets the least one, with one the mesh is in the middle.
            bounds = find_bounds(view._replace(tangents=np.zeros(2)), mesh)
            sides = (bounds.farthest - bounds.nearest, *(bounds.highest - bounds.lowest), SMALLEST_DISTANCE)
            local_eye = view.across @ bounds.middle + view.forward * (bounds.nearest - float(max(sides)))
            local_target = view.find_target(local_eye, bounds)
            half = np.abs(bounds.highest - bounds.lowest) / 2
            projection = _with_height(projection, half, aspect, mesh.scale)
        case Fisheye():
            # Sees the ball around the box.
            radius = max(float(np.linalg.norm(np.abs(mesh.local_box).max(axis=0))), SMALLEST_DISTANCE)
            half_angle = min(math.radians(projection.angle) / 2 * (1 - MARGIN), _WIDEST_HALF_ANGLE)
            local_eye, local_target = -view.forward * (radius / math.sin(half_angle)), np.zeros(3)
        case Panorama():
            # In the middle of the box, and level.
            axis = np.asarray(up, np.float64) / np.linalg.norm(up)
            level = view.forward - axis * (axis @ view.forward)
            local_eye, local_target = np.zeros(3), level / np.linalg.norm(level)
    at, look_at = (as_vector(mesh.origin + point / mesh.scale) for point in (local_eye, local_target))
    return Camera(at, look_at, find_sides(side, up)[1], fov, projection=projection)


def measure_side(mesh: Mesh | SceneBounds, side: str | None, up: Vector = DEFAULT_UP) -> tuple[float, float]:
    """Return the width and the height of a mesh as an orthographic picture from a side shows it, in its units."""
    view = View.from_side(side, 1.0, up, DEFAULT_FOV)._replace(tangents=np.zeros(2))
    bounds = find_bounds(view, mesh)
    width, height = ((bounds.highest - bounds.lowest) / mesh.scale).tolist()
    return width, height


# The slopes of the picture's sides for which bounds are known, as shares of the whole ones. With four of them, the two
# margins of a tilted plate differ by less than a hundredth of the picture.
_SHARES = (0.0, 1 / 3, 2 / 3, 1.0)


def _find_eye(view: View, mesh: Mesh | SceneBounds) -> tuple[NDArray[np.float64], ViewPlanes]:
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
    distance = view.find_distance(several[-1])
    centre = [_find_middle(several, view.tangents[axis] * distance, axis) for axis in range(2)]
    return view.across @ centre - distance * view.forward, several[-1]


def _find_middle(several: Sequence[ViewPlanes], reach: float, axis: int) -> float:
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


def look_from(
    mesh: Mesh | SceneBounds,
    projection: Projection | None,
    eye: Vector,
    look_at: Vector,
    *,
    aspect: float,
    up: Vector,
    fov: float,
) -> Camera:
    """Return the camera at a fixed position; an orthographic one without a height sees all of the mesh beside it."""
    if projection != Orthographic():
        return Camera(eye, look_at, up, fov, projection=projection)
    right, upward, forward = make_axes(np.subtract(look_at, eye), np.asarray(up, np.float64))
    view = View(np.stack([right, upward], axis=1), forward, np.zeros(2))
    bounds = find_bounds(view, mesh)
    centre = ((np.asarray(eye, np.float64) - mesh.origin) * mesh.scale) @ view.across
    half = np.maximum(bounds.highest - centre, centre - bounds.lowest)
    return Camera(eye, look_at, up, fov, projection=_with_height(Orthographic(), half, aspect, mesh.scale))


def _with_height(projection: Orthographic, half: NDArray[np.float64], aspect: float, scale: float) -> Orthographic:
    """Return the projection, with a height for these halves of what is seen, in local units, if it has none."""
    if projection.height is not None:
        return projection
    half_height = max(half[1], half[0] / aspect, SMALLEST_DISTANCE) / (1 - MARGIN)
    return replace(projection, height=float(2 * half_height / scale))

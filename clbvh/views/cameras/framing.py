"""Cameras that see the whole of a scene: from one side, or from all sides during a turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry import Mesh
from ...support.settings import Vector
from .arrays import as_vector
from .bounds import Reaches, SceneBounds
from .camera import Camera
from .pose import find_sides, make_axes
from .projection import DEFAULT_FOV, DEFAULT_UP, Fisheye, Orthographic, Panorama, Projection

# Around what is seen, as a share of the picture.
MARGIN = 0.06

# Points without extent still need a distance; in local units.
_SMALLEST_DISTANCE = 1e-6

# A wide fisheye sees everything from close by, but most of it at the side of its picture: it stands so far away that
# the scene takes up to half of its circle.
_WIDEST_HALF_ANGLE = math.radians(45)

_Array = NDArray[np.float64]


def frame_scene(
    bounds: SceneBounds,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
    look_at: Vector | None = None,
    projection: Projection | None = None,
    side: str | None = None,
    turns: bool = False,
) -> Camera:
    """Return a camera that sees all of a scene from a three-quarter view or a standard one, as close as possible.

    Parameters
    ----------
    bounds : SceneBounds
    aspect : float
        Width of the picture divided by its height.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    eye : (3,) float, optional
        A fixed position, from which all need not be seen.
    look_at : (3,) float, optional
        Where a camera with an eye looks; by default the middle of the box.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. The others have no `fov`; a panorama looks from the middle of the box. An orthographic one
        without a height gets the one that shows everything.
    side : str, optional
        One of `STANDARD_VIEWS`, in place of the three-quarter view and without an `eye`.
    turns : bool
        Whether all is to be seen while the camera orbits the axis `up` through the middle of the box.

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
    if eye is not None:
        look_at = as_vector(bounds.origin) if look_at is None else look_at
        if projection == Orthographic():
            view = _ViewAxes.along(np.subtract(look_at, eye), up)
            (planes,) = view.touch(bounds)
            centre = ((np.asarray(eye, np.float64) - bounds.origin) * bounds.scale) @ view.across
            half = np.maximum(planes.highest - centre, centre - planes.lowest)
            projection = _fit_height(half, aspect, bounds.scale)
        return Camera(eye, look_at, up, fov, projection=projection)
    if isinstance(projection, Panorama) and (turns or side in ("top", "bottom")):
        remedy = "has no turn: take another projection" if turns else f"looks level: take another view than '{side}'"
        raise SceneError(f"a panorama sees all sides at once and {remedy}")
    towards, picture_up = find_sides(side, up)
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    view = _ViewAxes.along(-towards, picture_up, axis if turns else None)
    match projection:
        case None:
            tangents = np.array([aspect, 1.0]) * math.tan(math.radians(fov) / 2) * (1 - MARGIN)
            local_eye, planes = _find_eye(view, tangents, bounds)
            local_target = view.find_target(local_eye, planes)
        case Orthographic():
            # Exact, too: without a height it gets the least one, with one the scene is in the middle.
            (planes,) = view.touch(bounds)
            distance = max(planes.farthest - planes.nearest, *planes.sides, _SMALLEST_DISTANCE)
            local_eye = view.across @ planes.middle + view.forward * (planes.nearest - distance)
            local_target = view.find_target(local_eye, planes)
            if projection.height is None:
                projection = _fit_height(np.abs(planes.sides) / 2, aspect, bounds.scale)
        case Fisheye():
            # Sees the ball around the box.
            radius = max(float(np.linalg.norm(np.abs(bounds.local_box).max(axis=0))), _SMALLEST_DISTANCE)
            half_angle = min(math.radians(projection.angle) / 2 * (1 - MARGIN), _WIDEST_HALF_ANGLE)
            local_eye, local_target = -view.forward * (radius / math.sin(half_angle)), np.zeros(3)
        case Panorama():
            # In the middle of the box, and level.
            level = view.forward - axis * (axis @ view.forward)
            local_eye, local_target = np.zeros(3), level / np.linalg.norm(level)
    at, target = (as_vector(bounds.origin + point / bounds.scale) for point in (local_eye, local_target))
    return Camera(at, target, picture_up, fov, projection=projection)


def frame_mesh(mesh: Mesh, *, aspect: float, **view: Any) -> Camera:
    """Return a camera that sees all of a mesh, see `frame_scene`."""
    return frame_scene(SceneBounds.of_mesh(mesh), aspect=aspect, **view)


def measure_side(bounds: SceneBounds, side: str | None, up: Vector = DEFAULT_UP) -> tuple[float, float]:
    """Return the width and the height of a scene as an orthographic picture from a side shows it, in its units."""
    towards, picture_up = find_sides(side, up)
    (planes,) = _ViewAxes.along(-towards, picture_up).touch(bounds)
    width, height = (planes.sides / bounds.scale).tolist()
    return width, height


def _fit_height(half: _Array, aspect: float, scale: float) -> Orthographic:
    """Return the orthographic projection that shows these halves of what is seen, (2,) in local units."""
    half_height = max(half[1], half[0] / aspect, _SMALLEST_DISTANCE) / (1 - MARGIN)
    return Orthographic(float(2 * half_height / scale))


class _Planes(NamedTuple):
    """The planes of a picture's four sides, moved inwards until they touch the points, and the depths of the points.

    In local coordinates; the horizontal planes first.
    """

    highest: _Array
    lowest: _Array
    nearest: float
    farthest: float

    @property
    def middle(self) -> _Array:
        """(2,) float64: halfway between the planes at depth 0, to the right and upwards."""
        return (self.highest + self.lowest) / 2

    @property
    def sides(self) -> _Array:
        """(2,) float64: the distances between the planes at depth 0."""
        return self.highest - self.lowest


class _ViewAxes(NamedTuple):
    """A direction of view.

    Attributes
    ----------
    across : (3, 2) float64
        Unit vectors right and up.
    forward : (3,) float64
    axis : (3,) float64, or None
        Unit vector of a turn around the line through zero, on which each point moves on a circle.
    """

    across: _Array
    forward: _Array
    axis: _Array | None

    @classmethod
    def along(cls, forward: _Array, up: Vector, axis: _Array | None = None) -> _ViewAxes:
        """Return a view by its line of sight, of any length, and the direction that is up in the picture."""
        right, upward, forward = make_axes(forward, np.asarray(up, np.float64))
        return cls(np.stack([right, upward], axis=1), forward, axis)

    def touch(self, bounds: SceneBounds, *tangents: _Array) -> list[_Planes]:
        """Return the planes for each pair of slopes of the sides, (2,); by default for parallel ones. Read once."""
        parts: list[Any] = []
        for each in tangents or (np.zeros(2),):
            leaning = each[:, None] * self.forward
            parts += [self.across.T - leaning, -self.across.T - leaning, [-self.forward, self.forward]]
        slopes = np.concatenate(parts)
        reaches = Reaches(slopes)
        if self.axis is not None:
            # The largest value on the circle of a point, at the distance r from the axis, is that of the part along the
            # axis, and r times the length of the rest.
            along = np.outer(slopes @ self.axis, self.axis)
            reaches = Reaches(along, np.linalg.norm(slopes - along, axis=1), self.axis)
        found = bounds.largest(reaches).reshape(len(parts) // 3, -1)
        return [_Planes(each[:2], -each[2:4], -float(each[4]), float(each[5])) for each in found]

    def find_target(self, eye: _Array, planes: _Planes) -> _Array:
        """Return where a camera at a point in local coordinates looks: the middle of what is seen, or the axis."""
        if self.axis is None:
            return eye + self.forward * ((planes.nearest + planes.farthest) / 2 - eye @ self.forward)
        level = self.forward - self.axis * (self.axis @ self.forward)
        return self.axis * (self.axis @ (eye - self.forward * ((eye @ level) / (self.forward @ level))))


# The slopes of the picture's sides for which planes are known, as shares of the whole ones. With four of them, the two
# margins of a tilted plate differ by less than a hundredth of the picture.
_SHARES = (0.0, 1 / 3, 2 / 3, 1.0)


def _find_eye(view: _ViewAxes, tangents: _Array, bounds: SceneBounds) -> tuple[_Array, _Planes]:
    """Return the eye of a picture that shows a whole scene, (3,) float64 in local coordinates, and its planes.

    Parameters
    ----------
    view : _ViewAxes
    tangents : (2,) float64
        Of half the field of view, horizontal and vertical, reduced by the margin.
    bounds : SceneBounds

    Notes
    -----
    The tightest pair of sides gives the distance of the eye. Where the other pair leaves room, the eye could stand
    anywhere between them. Halfway is not the middle of the picture: what is near moves more than what is far.
    The eye stands where a narrower picture would see all: for slopes s of its sides, the planes that touch the points
    from above and below meet the plane of the eye in ``highest(s) - s distance`` and ``lowest(s) + s distance``, and s
    is the least for which the first is not above the second. Both are known for a few s, and linear in between;
    as ``highest`` is convex and ``lowest`` concave, no point is left out.
    """
    several = view.touch(bounds, *(tangents * share for share in _SHARES))
    planes = several[-1]
    size = max(planes.farthest - planes.nearest, float(planes.sides.max()), _SMALLEST_DISTANCE)
    # A flat mesh seen edge-on touches no side, and no point may lie behind the eye.
    distance = max(float((planes.sides / (2 * tangents)).max()), -planes.nearest + 1e-3 * size)
    centre = [_find_middle(several, tangents[axis] * distance, axis) for axis in range(2)]
    return view.across @ centre - distance * view.forward, planes


def _find_middle(several: Sequence[_Planes], reach: float, axis: int) -> float:
    """Return the eye's coordinate along one axis of the picture; `reach` is half the picture's side in depth 0."""
    excesses = [float(planes.sides[axis]) - 2 * share * reach for share, planes in zip(_SHARES, several, strict=True)]
    # The last is 0 along the tightest axis, but for rounding.
    after = next((number for number, excess in enumerate(excesses[:-1]) if excess <= 0), len(_SHARES) - 1)
    if after == 0 or excesses[after] >= 0:
        return float(several[after].middle[axis])
    part = excesses[after - 1] / (excesses[after - 1] - excesses[after])
    before, behind = several[after - 1].middle[axis], several[after].middle[axis]
    return float(before + part * (behind - before))

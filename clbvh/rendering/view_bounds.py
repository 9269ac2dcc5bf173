"""The automatic view and its turn: the planes of the picture's sides, which tell where the eye has to be."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .pose import make_axes
from .standard_views import find_sides
from .vectors import Vector, as_vector

# Around what is seen, as a share of the picture.
MARGIN = 0.06

# Points without extent still need a distance; in local units.
SMALLEST_DISTANCE = 1e-6


class LocalSpace(Protocol):
    """Anything with local coordinates, which are ``(point - origin) * scale``."""

    @property
    def origin(self) -> NDArray[np.float64]:
        """(3,) float64, the scene's coordinates."""

    @property
    def scale(self) -> float:
        """A power of two."""


class Boxed(LocalSpace, Protocol):
    """A local space with a box around all that is in it."""

    @property
    def local_box(self) -> NDArray[np.floating]:
        """(2, 3) float, local coordinates."""


def box_in(boxed: Boxed, space: LocalSpace) -> NDArray[np.float64]:
    """Return (2, 3) float64: the box in the local coordinates of another space."""
    return ((boxed.origin - space.origin) + boxed.local_box / np.float64(boxed.scale)) * space.scale


class Reaches(NamedTuple):
    """Functions of a point in local coordinates, of each of which the largest value over all points is wanted.

    Function k is ``slopes[k] @ point + around[k] * distance``, with the point's distance from the line through zero
    along `axis`. It is convex and at most the sum of its values for two parts of the point.

    Attributes
    ----------
    slopes : (k, 3) float64
        Where `around` is not 0, parallel to `axis`.
    around : (k,) float64
        At least 0.
    axis : (3,) float64
        Unit vector.
    """

    slopes: NDArray[np.float64]
    around: NDArray[np.float64]
    axis: NDArray[np.float64]

    def of_points(
        self, points: NDArray[np.float64], linear: NDArray[np.float64], offset: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return (k, n) float64: the values for (n, 3) points, after a linear map, (3, 3), and a shift, (3,)."""
        values = (self.slopes @ linear) @ points.T
        values += (self.slopes @ offset)[:, None]
        if self.around.any():
            level = np.eye(3) - np.outer(self.axis, self.axis)
            aside = (level @ linear) @ points.T
            aside += (level @ offset)[:, None]
            values += self.around[:, None] * np.sqrt(np.einsum("in,in->n", aside, aside))
        return values

    def of_ball(self, linear: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (k,) float64: at least the values for the unit ball after a linear map, (3, 3).

        Equal to the largest ones unless the map stretches the ball and `around` is not 0.
        """
        along = np.linalg.norm(self.slopes @ linear, axis=1)
        if not self.around.any():
            return along
        stretch = np.linalg.norm(linear, ord=2)
        in_turn = np.hypot(np.linalg.norm(self.slopes, axis=1), self.around) * stretch
        return np.where(self.around > 0, in_turn, along)


class ViewBounds(NamedTuple):
    """The planes of a view's four sides, moved inwards until they touch the points, and the depths of the points.

    In local coordinates; the horizontal planes first.
    """

    highest: NDArray[np.float64]
    lowest: NDArray[np.float64]
    nearest: float
    farthest: float

    @property
    def middle(self) -> NDArray[np.float64]:
        """(2,) float64: halfway between the planes at depth 0, to the right and upwards."""
        return (self.highest + self.lowest) / 2


class View(NamedTuple):
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
    def from_side(cls, name: str | None, aspect: float, up: Vector, fov: float) -> View:
        """Return a standard view, see `find_sides`."""
        towards, picture_up = find_sides(name, up)
        right, upward, forward = make_axes(-towards, np.asarray(picture_up, np.float64))
        tangents = np.array([aspect, 1.0]) * math.tan(math.radians(fov) / 2) * (1 - MARGIN)
        return cls(np.stack([right, upward], axis=1), forward, tangents)

    def narrowed(self, share: float) -> View:
        """Return the view of a picture whose sides have this share of their slopes."""
        return self._replace(tangents=self.tangents * share)

    def reaches(self) -> Reaches:
        """Return the functions of a point whose largest values `bounds_of` needs."""
        leaning = self.tangents[:, None] * self.forward
        slopes = np.concatenate((self.across.T - leaning, -self.across.T - leaning, [-self.forward, self.forward]))
        return Reaches(slopes, np.zeros(len(slopes)), self.forward)

    def bounds_of(self, largest: NDArray[np.float64]) -> ViewBounds:
        """Return the bounds of points whose largest `reaches` are known."""
        return ViewBounds(largest[:2], -largest[2:4], -float(largest[4]), float(largest[5]))

    def find_distance(self, bounds: ViewBounds) -> float:
        """Return the distance of the nearest eye to the plane of depth 0."""
        distance = float(((bounds.highest - bounds.lowest) / (2 * self.tangents)).max())
        size = max(bounds.farthest - bounds.nearest, float((bounds.highest - bounds.lowest).max()), SMALLEST_DISTANCE)
        # A flat mesh seen edge-on touches no side, and no point may lie behind the eye.
        return max(distance, -bounds.nearest + 1e-3 * size)

    def make_camera(
        self, eye: NDArray[np.float64], bounds: ViewBounds, space: LocalSpace, up: Vector, fov: float
    ) -> Camera:
        """Return the camera at a point in local coordinates."""
        depth = (bounds.nearest + bounds.farthest) / 2 - eye @ self.forward
        return _make_camera(space, eye, eye + self.forward * depth, up, fov)


class Turn(NamedTuple):
    """A view during a turn around an axis through zero. Each point moves on a circle.

    Attributes
    ----------
    view : View
    axis, level : (3,) float64
        Unit vectors: the axis, and the direction of sight without its part along the axis. A point of a circle is at
        r (cos right + sin level) + h axis.
    """

    view: View
    axis: NDArray[np.float64]
    level: NDArray[np.float64]

    @classmethod
    def from_three_quarters(cls, aspect: float, up: Vector, fov: float) -> Turn:
        """Return the turn of the automatic view."""
        view = View.from_side(None, aspect, up, fov)
        axis = np.asarray(up, np.float64) / np.linalg.norm(up)
        level = view.forward - axis * (axis @ view.forward)
        level /= np.linalg.norm(level)
        return cls(view, axis, level)

    def narrowed(self, share: float) -> Turn:
        """Return the turn of a picture whose sides have this share of their slopes."""
        return self._replace(view=self.view.narrowed(share))

    def reaches(self) -> Reaches:
        """Return the functions of a point whose largest values `bounds_of` needs."""
        axis, level, upward = self.axis, self.level, self.view.across[:, 1]
        level_depth, axis_depth = float(level @ self.view.forward), float(axis @ self.view.forward)
        wide, high = self.view.tangents
        heights = [
            -axis_depth * wide,
            axis @ upward - axis_depth * high,
            -(axis @ upward + axis_depth * high),
            -axis_depth,
            axis_depth,
        ]
        around = [
            math.hypot(1.0, level_depth * wide),
            abs(level @ upward - level_depth * high),
            abs(level @ upward + level_depth * high),
            level_depth,
            level_depth,
        ]
        return Reaches(np.array(heights)[:, None] * axis, np.array(around), axis)

    def bounds_of(self, largest: NDArray[np.float64]) -> ViewBounds:
        """Return the bounds of points whose largest `reaches` are known."""
        side, above, below, nearest, farthest = largest
        return ViewBounds(np.array([side, above]), np.array([-side, -below]), -float(nearest), float(farthest))

    def make_camera(
        self, eye: NDArray[np.float64], bounds: ViewBounds, space: LocalSpace, up: Vector, fov: float
    ) -> Camera:
        """Return the camera at a point in local coordinates, in its first position."""
        level_depth = self.level @ self.view.forward
        # Where the line of sight meets the axis.
        target = self.axis * (self.axis @ (eye - self.view.forward * (eye @ self.level) / level_depth))
        return _make_camera(space, eye, target, up, fov)


def _make_camera(
    space: LocalSpace, local_eye: NDArray[np.float64], local_target: NDArray[np.float64], up: Vector, fov: float
) -> Camera:
    """Return the camera at a point in local coordinates that looks at another one."""
    eye, look_at = (as_vector(space.origin + point / space.scale) for point in (local_eye, local_target))
    return Camera(eye, look_at, up, fov)

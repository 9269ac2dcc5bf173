"""Bounds of a view: the planes of the picture's sides that touch a mesh or a scene, which tell where the eye has to be.

An instance of a scene reaches no farther than the corners of its box. So only those instances are read vertex by vertex
whose boxes reach farther than all vertices that were read before: a few of ten thousand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ..vectors import Vector
from .pose import find_sides, make_axes

if TYPE_CHECKING:
    from ...geometry.spheres import Shape


# Around what is seen, as a share of the picture.
MARGIN = 0.06

# Points without extent still need a distance; in local units.
SMALLEST_DISTANCE = 1e-6


def box_in(boxed: Mesh | SceneBounds, space: Mesh | SceneBounds) -> NDArray[np.float64]:
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


class ViewPlanes(NamedTuple):
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
    axis : (3,) float64, or None
        Unit vector of a turn around the line through zero, on which each point moves on a circle.
    """

    across: NDArray[np.float64]
    forward: NDArray[np.float64]
    tangents: NDArray[np.float64]
    axis: NDArray[np.float64] | None = None

    @classmethod
    def from_side(cls, name: str | None, aspect: float, up: Vector, fov: float, *, turns: bool = False) -> View:
        """Return a standard view, see `find_sides`; perhaps with a turn around `up`."""
        towards, picture_up = find_sides(name, up)
        right, upward, forward = make_axes(-towards, np.asarray(picture_up, np.float64))
        tangents = np.array([aspect, 1.0]) * math.tan(math.radians(fov) / 2) * (1 - MARGIN)
        axis = np.asarray(up, np.float64) / np.linalg.norm(up) if turns else None
        return cls(np.stack([right, upward], axis=1), forward, tangents, axis)

    def narrowed(self, share: float) -> View:
        """Return the view of a picture whose sides have this share of their slopes."""
        return self._replace(tangents=self.tangents * share)

    def reaches(self) -> Reaches:
        """Return the functions of a point whose largest values `bounds_of` needs."""
        leaning = self.tangents[:, None] * self.forward
        slopes = np.concatenate((self.across.T - leaning, -self.across.T - leaning, [-self.forward, self.forward]))
        if self.axis is None:
            return Reaches(slopes, np.zeros(len(slopes)), self.forward)
        # The largest value on the circle of a point, at the distance r from the axis, is that of the part along the
        # axis, and r times the length of the rest.
        along = np.outer(slopes @ self.axis, self.axis)
        return Reaches(along, np.linalg.norm(slopes - along, axis=1), self.axis)

    def bounds_of(self, largest: NDArray[np.float64]) -> ViewPlanes:
        """Return the bounds of points whose largest `reaches` are known."""
        return ViewPlanes(largest[:2], -largest[2:4], -float(largest[4]), float(largest[5]))

    def find_distance(self, bounds: ViewPlanes) -> float:
        """Return the distance of the nearest eye to the plane of depth 0."""
        distance = float(((bounds.highest - bounds.lowest) / (2 * self.tangents)).max())
        size = max(bounds.farthest - bounds.nearest, float((bounds.highest - bounds.lowest).max()), SMALLEST_DISTANCE)
        # A flat mesh seen edge-on touches no side, and no point may lie behind the eye.
        return max(distance, -bounds.nearest + 1e-3 * size)

    def find_target(self, eye: NDArray[np.float64], bounds: ViewPlanes) -> NDArray[np.float64]:
        """Return where a camera at a point in local coordinates looks: the middle of what is seen, or the axis."""
        if self.axis is None:
            return eye + self.forward * ((bounds.nearest + bounds.farthest) / 2 - eye @ self.forward)
        level = self.forward - self.axis * (self.axis @ self.forward)
        return self.axis * (self.axis @ (eye - self.forward * ((eye @ level) / (self.forward @ level))))


# Vertices, or corners of boxes, per step: 10 MB at a time.
_CHUNK_POINTS = 2**17

# Vertices and centres that are read for one answer, about half a second on a 2-core x86-64 server; but every geometry
# may be read once. From then on the boxes count instead: a camera stands a little farther away than it could.
_MOST_POINTS = 2**24

# A visit of an instance costs as much as this many points, and a search among instances as one point each.
_POINTS_PER_VISIT = 1000

# Boxes are known in float32: no vertex is outside by more than this share of the box.
_BOX_ERROR = 2.0**-20

_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

# The largest and the least coordinates.
_ALONG_AXES = Reaches(np.concatenate((np.eye(3), -np.eye(3))), np.zeros(6), np.array([0.0, 0.0, 1.0]))


class SceneBounds:
    """Where the instances of a scene are.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
    geometry_ids : (n,) int
        The shape of each instance; at least one.
    transforms : (n, 4, 4) float64
        From each shape's coordinates to the scene's.

    Attributes
    ----------
    shapes, geometry_ids, transforms
        As given.
    origin : (3,) float64, the scene's coordinates
        Centre of the box around all vertices and spheres.
    scale : float
        A power of two: local units in one unit of the scene. The largest half side of the box is from 0.5 to 1 local
        units, or 0.
    local_box : (2, 3) float64
        The box in local coordinates, which are ``(point - origin) * scale``.
    """

    def __init__(
        self, shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], transforms: NDArray[np.float64]
    ) -> None:
        self.shapes = shapes
        self.geometry_ids = np.asarray(geometry_ids)
        self.transforms = np.asarray(transforms, np.float64)
        self._half_sizes = np.stack([_half_size(shape) for shape in shapes])
        self._centres = self.transforms[:, :3, 3] + np.einsum(
            "nij,nj->ni", self.transforms[:, :3, :3], np.stack([shape.origin for shape in shapes])[self.geometry_ids]
        )
        # First the box of all boxes, then, in its coordinates, that of all vertices.
        lower, upper = self.instance_boxes()
        self._use_box(lower.min(axis=0), upper.max(axis=0))
        largest = self.largest(_ALONG_AXES)
        self._use_box(self.origin - largest[3:] / self.scale, self.origin + largest[:3] / self.scale)

    def instance_boxes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lower and upper corners, (n, 3), of boxes around the instances, in the scene's coordinates."""
        reach = np.einsum("nij,nj->ni", np.abs(self.transforms[:, :3, :3]), self._half_sizes[self.geometry_ids])
        return self._centres - reach, self._centres + reach

    def _use_box(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> None:
        """Make this the box, and its centre the origin."""
        half = upper / 2 - lower / 2
        self.origin = lower + (upper - lower) / 2
        self.scale = math.ldexp(1.0, -math.frexp(float(half.max()))[1])
        self.local_box = np.stack(((lower - self.origin) * self.scale, (upper - self.origin) * self.scale))
        self._offsets = (self._centres - self.origin) * self.scale
        self._linear = self.transforms[:, :3, :3] * self.scale

    def largest(self, reaches: Reaches) -> NDArray[np.float64]:
        """Return (k,) float64: the largest value of each function over all vertices and spheres, or a little more."""
        bounds = self._bound_boxes(reaches)
        best = np.full(bounds.shape[1], -np.inf)
        budget = _MOST_POINTS + sum(_count_points(shape) for shape in self.shapes)
        for function in range(bounds.shape[1]):
            while True:
                instance = int(np.argmax(bounds[:, function]))
                if not bounds[instance, function] > best[function]:
                    break
                if budget <= 0:
                    best[function] = bounds[instance, function]
                    break
                best = np.maximum(best, self._reach_of(instance, reaches))
                # Its box has said all that it can.
                bounds[instance] = -np.inf
                shape = self.shapes[self.geometry_ids[instance]]
                budget -= _count_points(shape) + _POINTS_PER_VISIT + len(bounds)
        return best

    def _bound_boxes(self, reaches: Reaches) -> NDArray[np.float64]:
        """Return (n, k) float64: at least the values that each instance reaches, from the corners of its box."""
        bounds = np.empty((len(self._offsets), len(reaches.slopes)))
        step = _CHUNK_POINTS // len(_CORNERS)
        for begin in range(0, len(bounds), step):
            part = slice(begin, begin + step)
            sides = self._linear[part] * self._half_sizes[self.geometry_ids[part], None, :]
            corners = self._offsets[part, None, :] + _CORNERS @ sides.transpose(0, 2, 1)
            values = reaches.of_points(corners.reshape(-1, 3), np.eye(3), np.zeros(3))
            bounds[part] = values.reshape(len(values), -1, len(_CORNERS)).max(axis=2).T
        return bounds

    def _reach_of(self, instance: int, reaches: Reaches) -> NDArray[np.float64]:
        """Return (k,) float64: the largest value of each function over one instance."""
        shape, linear = self.shapes[self.geometry_ids[instance]], self._linear[instance]
        points = shape.vertices if isinstance(shape, Mesh) else shape.centres
        largest = np.full(len(reaches.slopes), -np.inf)
        for begin in range(0, len(points), _CHUNK_POINTS):
            part = slice(begin, begin + _CHUNK_POINTS)
            values = reaches.of_points(points[part] - shape.origin, linear, self._offsets[instance])
            if not isinstance(shape, Mesh):
                values += reaches.of_ball(linear)[:, None] * shape.radii[part]
            largest = np.maximum(largest, values.max(axis=1))
        return largest


def _half_size(shape: Shape) -> NDArray[np.float64]:
    """Return (3,) float64: half the sides of a box around a shape's origin that contains the shape."""
    local = np.abs(shape.local_box.astype(np.float64)).max(axis=0)
    return (local + _BOX_ERROR * local.max()) / shape.scale


def _count_points(shape: Shape) -> int:
    return len(shape.vertices) if isinstance(shape, Mesh) else shape.prim_count


# Vertices per step: they stay in the cache, and OpenBLAS starts no threads for so few. With four times as many, its
# threads took 0.4 s of two busy cores for the dragon's vertices and four views; now it is 5 ms.
_CHUNK_VERTICES = 2**12


def find_bounds(view: View, mesh: Mesh | SceneBounds) -> ViewPlanes:
    """Return the bounds of all vertices, or of all that a scene holds."""
    return find_bounds_of_all([view], mesh)[0]


def find_bounds_of_all(views: Sequence[View], mesh: Mesh | SceneBounds) -> list[ViewPlanes]:
    """Return the bounds of several views that differ in nothing but the slopes of their sides; read once."""
    reaches = [view.reaches() for view in views]
    joined = Reaches(
        np.concatenate([each.slopes for each in reaches]),
        np.concatenate([each.around for each in reaches]),
        reaches[0].axis,
    )
    largest = _find_largest(joined, mesh)
    return [view.bounds_of(part) for view, part in zip(views, np.split(largest, len(views)), strict=True)]


def _find_largest(reaches: Reaches, mesh: Mesh | SceneBounds) -> NDArray[np.float64]:
    """Return (k,) float64: the largest value of each function."""
    if isinstance(mesh, SceneBounds):
        return mesh.largest(reaches)
    largest = np.full(len(reaches.slopes), -np.inf)
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        points: NDArray[np.float64] = mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)
        largest = np.maximum(largest, reaches.of_points(points, np.eye(3), np.zeros(3)).max(axis=1))
    return largest

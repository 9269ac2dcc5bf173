"""How far a scene reaches: the box around it, and the largest values of functions over all of its points.

An instance reaches no farther than the corners of its box. So only those instances are read vertex by vertex whose
boxes reach farther than all vertices that were read before: a few of ten thousand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh, Shape
from ...geometry.loading.file_parts import POINT
from ...scene.state import SceneState

_Array = NDArray[np.float64]


class Reaches(NamedTuple):
    """Functions of a point in local coordinates, of each of which the largest value over all points is wanted.

    Function k is ``slopes[k] @ point + around[k] * distance``, with the point's distance from the line through zero
    along `axis`. It is convex and at most the sum of its values for two parts of the point.

    Attributes
    ----------
    slopes : (k, 3) float64
        Where `around` is not 0, parallel to `axis`.
    around : (k,) float64, optional
        At least 0.
    axis : (3,) float64
        Unit vector; needed with `around`.
    """

    slopes: _Array
    around: _Array | None = None
    axis: _Array = np.array([0.0, 0.0, 1.0])

    def of_points(self, points: _Array, linear: _Array, offset: _Array) -> _Array:
        """Return (k, n) float64: the values for (n, 3) points, after a linear map, (3, 3), and a shift, (3,)."""
        values = (self.slopes @ linear) @ points.T
        values += (self.slopes @ offset)[:, None]
        if self.around is not None:
            level = np.eye(3) - np.outer(self.axis, self.axis)
            aside = (level @ linear) @ points.T
            aside += (level @ offset)[:, None]
            values += self.around[:, None] * np.sqrt(np.einsum("in,in->n", aside, aside))
        return values

    def of_ball(self, linear: _Array) -> _Array:
        """Return (k,) float64: at least the values for the unit ball after a linear map, (3, 3).

        Equal to the largest ones unless the map stretches the ball and `around` is not 0.
        """
        along = np.linalg.norm(self.slopes @ linear, axis=1)
        if self.around is None:
            return along
        in_turn = np.hypot(np.linalg.norm(self.slopes, axis=1), self.around) * np.linalg.norm(linear, ord=2)
        return np.where(self.around > 0, in_turn, along)


# Points per step: they stay in the cache, and OpenBLAS starts no threads for so few. With four times as many, its
# threads took 0.4 s of two busy cores for the dragon's vertices and four views; now it is 5 ms.
_CHUNK_POINTS = 2**12

# Vertices and centres that are read for one answer, about half a second on a 2-core x86-64 server; but every geometry
# may be read once. From then on the boxes count instead: a camera stands a little farther away than it could.
_MOST_POINTS = 2**24

# A visit of an instance costs as much as this many points, and a search among instances as one point each.
_POINTS_PER_VISIT = 1000

# Boxes are known in float32: no vertex is outside by more than this share of the box.
_BOX_ERROR = 2.0**-20

_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

# The largest and the least coordinates.
_ALONG_AXES = Reaches(np.concatenate((np.eye(3), -np.eye(3))))


class SceneBounds:
    """Where the instances of a scene are, and how far they reach.

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
    local_box : (2, 3) float
        The box in local coordinates, which are ``(point - origin) * scale``.
    is_empty : bool
        Whether nothing is shown, and a point is in its place.

    Notes
    -----
    One mesh in its own place has its own local coordinates, and float32 vertices: those that are drawn.
    """

    is_empty = False

    def __init__(self, shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], transforms: _Array) -> None:
        self.shapes = shapes
        self.geometry_ids = np.asarray(geometry_ids)
        self.transforms = np.asarray(transforms, np.float64)
        self._scales = np.array([shape.scale for shape in shapes])[self.geometry_ids, None]
        self._half_sizes = _half_sizes(shapes)[self.geometry_ids]
        origins = np.array([shape.origin for shape in shapes])[self.geometry_ids]
        self._centres = self.transforms[:, :3, 3] + np.einsum("nij,nj->ni", self.transforms[:, :3, :3], origins)
        first = shapes[self.geometry_ids[0]]
        self._is_one_mesh = isinstance(first, Mesh) and np.array_equal(self.transforms, np.eye(4)[None])
        if self._is_one_mesh:
            self._use_frame(first.origin, first.scale)
            self.local_box: NDArray[np.floating] = first.local_box
            return
        # First the box of all boxes, then, in its coordinates, that of all vertices.
        lower, upper = self.instance_boxes()
        self._use_box(lower.min(axis=0), upper.max(axis=0))
        largest = self.largest(_ALONG_AXES)
        self._use_box(self.origin - largest[3:] / self.scale, self.origin + largest[:3] / self.scale)

    @classmethod
    def of_state(cls, state: SceneState) -> SceneBounds:
        """Return the bounds of the instances of a scene whose mask is not 0; NaN where float64 has no room for them."""
        shown = state.masks > 0
        if not shown.any():
            bounds = cls.of_mesh(Mesh.from_arrays(*POINT))
            bounds.is_empty = True
            return bounds
        with np.errstate(over="ignore", invalid="ignore"):
            return cls(state.shapes, state.geometry_ids[shown], state.transforms[shown])

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> SceneBounds:
        """Return the bounds of one mesh in its own place."""
        return cls((mesh,), np.zeros(1, np.int64), np.eye(4)[None])

    def instance_boxes(self) -> tuple[_Array, _Array]:
        """Return the lower and upper corners, (n, 3), of boxes around the instances, in the scene's coordinates."""
        reach = np.einsum("nij,nj->ni", np.abs(self.transforms[:, :3, :3]), self._half_sizes / self._scales)
        return self._centres - reach, self._centres + reach

    def _use_box(self, lower: _Array, upper: _Array) -> None:
        """Make this the box, and its centre the origin."""
        half = upper / 2 - lower / 2
        self._use_frame(lower + (upper - lower) / 2, math.ldexp(1.0, -math.frexp(float(half.max()))[1]))
        self.local_box = np.stack(((lower - self.origin) * self.scale, (upper - self.origin) * self.scale))

    def _use_frame(self, origin: _Array, scale: float) -> None:
        """Make these the local coordinates; keep the maps from the local ones of each instance's shape."""
        self.origin, self.scale = origin, scale
        self._offsets = (self._centres - origin) * scale
        self._linear = self.transforms[:, :3, :3] * (scale / self._scales)[:, :, None]

    def box_in(self, space: Any) -> _Array:
        """Return (2, 3) float64: the box in the local coordinates of a mesh or of other bounds."""
        return ((self.origin - space.origin) + self.local_box / np.float64(self.scale)) * space.scale

    def points(self, instance: int, chosen: Any) -> _Array:
        """Return (n, 3) float64, local units: some vertices or centres of an instance, by a slice or indices."""
        points = self._shape_points(self.shapes[self.geometry_ids[instance]], chosen)
        return points @ self._linear[instance].T + self._offsets[instance]

    def lowest(self, normal: _Array) -> float:
        """Return the least height along a unit vector, in local units."""
        return -float(self.largest(Reaches(-normal[None]))[0])

    def largest(self, reaches: Reaches) -> _Array:
        """Return (k,) float64: the largest value of each function over all vertices and spheres, or a little more."""
        bounds = self._bound_boxes(reaches)
        best = np.full(bounds.shape[1], -np.inf)
        budget = _MOST_POINTS + sum(len(shape.balls[0]) for shape in self.shapes)
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
                point_count = len(self.shapes[self.geometry_ids[instance]].balls[0])
                budget -= point_count + _POINTS_PER_VISIT + len(bounds)
        return best

    def _bound_boxes(self, reaches: Reaches) -> _Array:
        """Return (n, k) float64: at least the values that each instance reaches, from the corners of its box."""
        bounds = np.empty((len(self._offsets), len(reaches.slopes)))
        step = _CHUNK_POINTS // len(_CORNERS)
        for begin in range(0, len(bounds), step):
            part = slice(begin, begin + step)
            sides = self._linear[part] * self._half_sizes[part, None, :]
            corners = self._offsets[part, None, :] + _CORNERS @ sides.transpose(0, 2, 1)
            values = reaches.of_points(corners.reshape(-1, 3), np.eye(3), np.zeros(3))
            bounds[part] = values.reshape(len(values), -1, len(_CORNERS)).max(axis=2).T
        return bounds

    def _reach_of(self, instance: int, reaches: Reaches) -> _Array:
        """Return (k,) float64: the largest value of each function over one instance."""
        shape, linear = self.shapes[self.geometry_ids[instance]], self._linear[instance]
        largest = np.full(len(reaches.slopes), -np.inf)
        for begin in range(0, len(shape.balls[0]), _CHUNK_POINTS):
            part = slice(begin, begin + _CHUNK_POINTS)
            values = reaches.of_points(self._shape_points(shape, part), linear, self._offsets[instance])
            if (radii := shape.balls[1]) is not None:
                values += reaches.of_ball(linear)[:, None] * (radii[part] * shape.scale)
            largest = np.maximum(largest, values.max(axis=1))
        return largest

    def _shape_points(self, shape: Shape, chosen: Any) -> _Array:
        """Return (n, 3) float64: some vertices or centres in the local coordinates of their shape."""
        if self._is_one_mesh:
            return shape.local_vertices[chosen].astype(np.float64)  # type: ignore[union-attr]
        return (shape.balls[0][chosen] - shape.origin) * shape.scale


def _half_sizes(shapes: Sequence[Shape]) -> _Array:
    """Return (n, 3) float64: half the sides of a box around zero that contains each shape, in its local coordinates."""
    local = np.abs(np.array([shape.local_box for shape in shapes], np.float64)).max(axis=1)
    return np.asarray(local + _BOX_ERROR * local.max(axis=1, keepdims=True))

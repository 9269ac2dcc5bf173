"""The extent of all that a scene holds: its box, and how far it reaches in any direction, without copies of instances.

An instance reaches no farther than the corners of its box. So only those instances are read vertex by vertex whose
boxes reach farther than all vertices that were read before: a few of ten thousand.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .view_bounds import Reaches

if TYPE_CHECKING:
    from ..geometry.shape import Shape

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


class SceneExtent:
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
        reach = np.einsum("nij,nj->ni", np.abs(self.transforms[:, :3, :3]), self._half_sizes[self.geometry_ids])
        self._use_box((self._centres - reach).min(axis=0), (self._centres + reach).max(axis=0))
        largest = self.largest(_ALONG_AXES)
        self._use_box(self.origin - largest[3:] / self.scale, self.origin + largest[:3] / self.scale)

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

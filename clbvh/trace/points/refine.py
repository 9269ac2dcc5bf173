"""The closest points of the primitives that the device found, in float64."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.host.loops import Loops
from ...structs import HIT, NO_PRIM
from ..hits.hits import Hits, show_found, show_index, show_values
from ..hits.normals import Normals
from ..hits.surface import Surface
from ..world.metrics import Metrics
from ..world.surface_arrays import SurfaceArrays
from ..world.tree_box import TreeBox


class _Points(NamedTuple):
    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]


class ClosestPoints(_Points):
    """The closest points of a surface; as a tuple distance, point and prim_id.

    Attributes
    ----------
    distance : (...,) float64, the file's unit
    point : (..., 3) float64, the file's coordinates
    prim_id : (...,) int32
        The face, or the sphere, that the point is on.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh) as tracer:
    ...     closest = tracer.closest_point([[1, 1, 3], [-3, -4, 0]])
    >>> closest
    ClosestPoints(shape=(2,), found=2, distance=3..5)
      [0] distance=3, prim_id=0, instance_id=0, point=(1, 1, 0)
      [1] distance=5, prim_id=0, instance_id=0, point=(0, 0, 0)
    >>> distance, point, prim_id = closest
    >>> distance, point
    (array([3., 5.]), array([[1., 1., 0.],
           [0., 0., 0.]]))
    >>> closest.u, closest.normals[0], closest.interpolate([10, 20, 30])
    (array([0.25, 0.  ]), array([0., 0., 1.]), array([17.5, 10. ]))
    """

    # u, v, instance_id and surface, where they are known.
    _place: tuple[Any, Any, Any, Surface | None]

    def __new__(
        cls, distance: NDArray[np.float64], point: NDArray[np.float64], prim_id: NDArray[np.int32],
        place: tuple[Any, Any, Any, Surface | None] | None = None,
    ) -> ClosestPoints:  # fmt: skip
        """Return the closest points, with u, v, instance_id and the surface of each, if they are known."""
        closest = super().__new__(cls, distance, point, prim_id)
        nothing = np.zeros(np.shape(prim_id)) if place is None else None
        closest._place = (nothing, nothing, None, None) if place is None else place
        return closest

    def as_hits(self) -> Hits:
        """Return the points as if rays of length 1 from the points asked for had hit them: t is the distance.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        ...     tracer.closest_point([0, 0, 3]).as_hits().locations.round(2)
        array([0., 0., 1.])
        """
        u, v, instance_id, surface = self._place
        return Hits(self.distance, u, v, self.prim_id, surface=surface, known_instance_id=instance_id)

    @property
    def u(self) -> NDArray[np.floating]:
        """(...,) float64: barycentric coordinate of the corner b, or the azimuth on a sphere, see `Hits`."""
        return self._place[0]

    @property
    def v(self) -> NDArray[np.floating]:
        """(...,) float64: barycentric coordinate of the corner c, or the angle on a sphere, see `Hits`."""
        return self._place[1]

    @property
    def geometry_id(self) -> NDArray[np.int32]:
        """(...,) int32: the geometry that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return self.as_hits().geometry_id

    @property
    def instance_id(self) -> NDArray[np.int32]:
        """(...,) int32: the instance that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return self.as_hits().instance_id

    @property
    def part_id(self) -> NDArray[np.int32]:
        """(...,) int32: the part that the point is on, see `Hits.part_id`."""
        return self.as_hits().part_id

    @property
    def normals(self) -> Normals:
        """(..., 3) float64: the normal of the primitive there, or ``normals(smooth=True)``; see `Hits.normals`."""
        return self.as_hits().normals

    def interpolate(self, attribute: ArrayLike | Mapping[Any, ArrayLike]) -> NDArray[np.float64]:
        """Return the values of an attribute at the points: colours, temperatures; see `Hits.interpolate`.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
        >>> clbvh.Tracer(mesh).closest_point([1, 2, 9]).interpolate([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
        array([0.25, 0.25, 0.5 ])
        """
        return self.as_hits().interpolate(attribute)

    def offset_origins(self, *, towards: ArrayLike) -> NDArray[np.float64]:
        """Return start points of rays that leave the surface at the points; see `Hits.offset_origins`.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        ...     closest = tracer.closest_point([0, 0, 3])
        ...     tracer.any_hit(closest.offset_origins(towards=[0, 0, 1]), [0, 0, 1])
        array(False)
        """
        return self.as_hits().offset_origins(towards=towards)

    def __repr__(self) -> str:
        shape, is_found = self.prim_id.shape, self.prim_id != NO_PRIM
        if not shape:
            return f"ClosestPoints({self._show(()) if is_found else 'none'})"
        return show_found(
            f"ClosestPoints(shape={shape}, found={np.count_nonzero(is_found):,}", "distance", self.distance, is_found,
            lambda row: f"{show_index(row, shape)} {self._show(np.unravel_index(row, shape))}",
        )  # fmt: skip

    def _show(self, index: Any) -> str:
        instance = {"instance_id": self.instance_id[index]}
        return show_values(
            distance=self.distance[index], prim_id=self.prim_id[index], **instance, point=self.point[index]
        )


class AllClosestPoints(ClosestPoints):
    """The closest points of several primitives for each point, grouped by point; the nearest come first.

    The arrays of `ClosestPoints` have one entry for each primitive that was found.

    Attributes
    ----------
    offsets : (n + 1,) int64
        The primitives of point i, in C order, are those from ``offsets[i]`` to ``offsets[i + 1]``.

    Examples
    --------
    >>> import clbvh
    >>> balls = clbvh.Spheres([[0, 0, 0], [4, 0, 0], [9, 0, 0]], 1)
    >>> with clbvh.Tracer(clbvh.Scene(balls)) as tracer:
    ...     near = tracer.prims_within([[3, 0, 0], [20, 0, 0], [6, 0, 0]], 2.5)
    >>> near.counts, near.point_id, near.prim_id
    (array([2, 0, 2]), array([0, 0, 2, 2]), array([1, 0, 1, 2], dtype=int32))
    """

    offsets: NDArray[np.int64]

    @classmethod
    def _of(cls, closest: ClosestPoints, counts: NDArray[np.int64]) -> AllClosestPoints:
        """Return closest points that are sorted by the points asked for, given the number of each."""
        grouped = cls(*closest, closest._place)
        grouped.offsets = np.concatenate(([0], np.cumsum(counts)))
        return grouped

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) int64: primitives of each point."""
        return np.diff(self.offsets)

    @property
    def point_id(self) -> NDArray[np.int64]:
        """(m,) int64: the point that each primitive was found for, by its number in C order."""
        return np.repeat(np.arange(len(self.offsets) - 1), self.counts)


_LOOPS = Loops("points/refine")


class FoundPoints(NamedTuple):
    """The results for points, (n,) each.

    Attributes
    ----------
    distance : (n,) float64, the scene's unit
    point : (n, 3) float64, the scene's coordinates
    u, v : (n,) float64
        The coordinates on the primitive; see `Hits`.
    prim_id, instance_id : (n,) int32
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, count: int) -> FoundPoints:
        """Return arrays for a number of points, which are not filled."""
        prims = np.empty(count, np.int32), np.empty(count, np.int32)
        return cls(np.empty(count), np.empty((count, 3)), np.empty(count), np.empty(count), *prims)

    def part(self, begin: int, end: int) -> FoundPoints:
        """Return views of the results of points `begin` to `end`."""
        if end - begin == len(self.distance):  # views would cost a call with one point 3 % of its time
            return self
        return FoundPoints(*(values[begin:end] for values in self))  # type: ignore[arg-type]

    def take(self, rows: NDArray[np.int64]) -> FoundPoints:
        """Return some of the results."""
        return FoundPoints(*(values[rows] for values in self))  # type: ignore[arg-type]

    def drop(self, rows: NDArray[np.bool_]) -> None:
        """Leave nothing of some of the results."""
        nothing = np.inf, np.nan, 0.0, 0.0, NO_PRIM, NO_PRIM
        values: Any
        for values, none in zip(self, nothing, strict=True):
            values[rows] = none

    def drop_beyond(self, limits: NDArray[np.float64], shape: tuple[int, ...], count: int = 1) -> None:
        """Leave nothing beyond limits, which are broadcast to a shape, and hold for `count` results each."""
        if limits.ndim or limits < np.inf:
            far = np.broadcast_to(limits, shape).reshape(-1, 1)
            self.drop((self.distance.reshape(-1, count) > far).reshape(-1))

    def as_closest(self, shape: tuple[int, ...], surface: Surface) -> ClosestPoints:
        """Return the results in a shape, given the surface that they are on."""
        u, v, instance_id = (values.reshape(shape) for values in (self.u, self.v, self.instance_id))
        distance, point, prim_id = self.distance.reshape(shape), self.point.reshape(*shape, 3), self.prim_id
        return ClosestPoints(distance, point, prim_id.reshape(shape), (u, v, instance_id, surface))


def refine_points(
    points: NDArray[Any],
    arrays: SurfaceArrays,
    metrics: Metrics,
    box: TreeBox,
    order: NDArray[np.int32],
    prims: NDArray[Any],
    found: FoundPoints,
    slots: NDArray[np.int32],
) -> None:
    """Write the point of each primitive that is closest to a point, in float64.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the world's coordinates
    arrays : SurfaceArrays
    metrics : Metrics
        Of the instances.
    box : TreeBox
        Of the world.
    order : (m,) int32
        The point of each primitive, by its index.
    prims : (m,) structs with a prim_id
        Primitives that the device found: hits, or with an instance_id of their own.
    found : FoundPoints, written
        Without a primitive the distance is infinite, the point NaN, and the ids `NO_PRIM`.
    slots : (m,) int32
        Where to write each of them.
    """
    prim_ids = prims["prim_id"].copy()
    instance_ids = np.minimum(prim_ids, 0) if prims.dtype == HIT else prims["instance_id"].copy()
    _LOOPS.refine_points(
        points, points.itemsize == 8, order, *_world_of(arrays, metrics, box), prim_ids, instance_ids, slots, *found
    )


def choose_points(
    points: NDArray[Any], arrays: SurfaceArrays, metrics: Metrics, box: TreeBox, hits: NDArray[Any],
    order: NDArray[np.int32], slot_count: int, count: int, found: FoundPoints,
) -> NDArray[np.int32]:  # fmt: skip
    """Write the nearest of the primitives that the device has found, and return the points with too few slots.

    Parameters
    ----------
    points, arrays, metrics, box
        As in `refine_points`.
    hits : (m * slot_count,) `structs.HIT` or `structs.WORLD_HIT`
        See cl/kernels/closest_points.cl.
    order : (m,) int32
        The points that they are of, by their indices.
    slot_count, count : int
        Primitives found, and wanted, of each point.
    found : FoundPoints, written
        Of (n * count,) primitives, nearest first, in the order of instances and primitives where they are equally near.
    """
    of_kind = (np.ascontiguousarray(hits), None)
    candidates, crowded = np.empty(2 * slot_count), np.empty(len(order), np.int32)
    crowded_count = _LOOPS.choose_points(
        points, points.itemsize == 8, order, *_world_of(arrays, metrics, box),
        *(of_kind if arrays.is_lone else of_kind[::-1]), slot_count, count, candidates, crowded, *found,
    )  # fmt: skip
    return crowded[:crowded_count]


def _world_of(arrays: SurfaceArrays, metrics: Metrics, box: TreeBox) -> tuple[Any, ...]:
    return arrays.addresses, metrics.axes, metrics.half_lengths, box.as_numbers()

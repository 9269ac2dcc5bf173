"""The closest points of the primitives that the device found, in float64."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...structs import HIT, NO_PRIM
from ..hits.hits import show_found, show_index, show_values
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
    """

    _ids: tuple[NDArray[np.int32], NDArray[np.int32]] | None = None

    def __new__(
        cls,
        distance: NDArray[np.float64],
        point: NDArray[np.float64],
        prim_id: NDArray[np.int32],
        geometry_id: NDArray[np.int32] | None = None,
        instance_id: NDArray[np.int32] | None = None,
    ) -> ClosestPoints:
        """Return the closest points with their ids, which are 0 where there is a point unless they are given."""
        closest = super().__new__(cls, distance, point, prim_id)
        if geometry_id is not None and instance_id is not None:
            closest._ids = geometry_id, instance_id
        return closest

    @property
    def geometry_id(self) -> NDArray[np.int32]:
        """(...,) int32: the geometry that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0) if self._ids is None else self._ids[0]

    @property
    def instance_id(self) -> NDArray[np.int32]:
        """(...,) int32: the instance that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0) if self._ids is None else self._ids[1]

    def __repr__(self) -> str:
        shape, is_found = self.prim_id.shape, self.prim_id != NO_PRIM
        if not shape:
            return f"ClosestPoints({self._show(()) if is_found else 'none'})"
        return show_found(
            f"ClosestPoints(shape={shape}, found={np.count_nonzero(is_found):,}", "distance", self.distance, is_found,
            lambda row: f"{show_index(row, shape)} {self._show(np.unravel_index(row, shape))}",
        )  # fmt: skip

    def _show(self, index: Any) -> str:
        instance = {} if self._ids is None else {"instance_id": self.instance_id[index]}
        return show_values(
            distance=self.distance[index], prim_id=self.prim_id[index], **instance, point=self.point[index]
        )


_LOOPS = Loops("points/refine")


class FoundPoints(NamedTuple):
    """The results for points, (n,) each.

    Attributes
    ----------
    distance : (n,) float64, the scene's unit
    point : (n, 3) float64, the scene's coordinates
    prim_id, instance_id : (n,) int32
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, count: int) -> FoundPoints:
        """Return arrays for a number of points, which are not filled."""
        return cls(np.empty(count), np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32))

    def part(self, begin: int, end: int) -> FoundPoints:
        """Return views of the results of points `begin` to `end`."""
        distance, point, prim_id, instance_id = self
        return FoundPoints(distance[begin:end], point[begin:end], prim_id[begin:end], instance_id[begin:end])

    def as_closest(self, shape: tuple[int, ...], geometry_ids: NDArray[np.int32]) -> ClosestPoints:
        """Return the results in a shape, given the geometry of each instance."""
        distance, point, prim_id, instance_id = self
        geometry_id = np.where(instance_id == NO_PRIM, NO_PRIM, geometry_ids[instance_id])
        return ClosestPoints(
            distance.reshape(shape), point.reshape(*shape, 3), prim_id.reshape(shape), geometry_id.reshape(shape),
            instance_id.reshape(shape),
        )  # fmt: skip


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

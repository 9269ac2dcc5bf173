"""The queries of points, whatever the tracer's tree is: a mesh, or the instances of a scene.

Owns what is visible to points, what the answers are where nothing is, and how points are cast.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import NO_PRIM, WORLD_PRIM
from ..hits.closest import count_hits
from ..launch import Call, Caster, Query, cut_smaller_when_full
from ..rays.batch import Broadcast, TreeBox, check_room, read_masks, read_points, read_rays
from ..rays.pieces import Progress, cut_points
from ..world.top_tree import prune_top
from ..world.world import with_instances
from .pack import cut_points_of, find_point_order, pack_points, put_points, take_masks, take_points
from .refine import ClosestPoints, FoundPoints, refine_points

CLOSEST_POINT = Query("closest_point", "prim_ids", np.dtype(np.int32))
_SCENE_CLOSEST_POINT = Query("scene_closest_point", "prims", WORLD_PRIM)
_INSIDE = Query("scene_inside", "inside", np.dtype(np.uint8))
_DEPTH = Query("scene_depth", "prims", WORLD_PRIM)

# Distance, point and ids of a point.
_POINT_BYTES = 40

# Directions along which crossings are counted, in this order of preference. Any will do: a direction that no mesh is
# modelled along meets few edges exactly, where the traversal has the most to do.
GENERIC_DIRECTIONS = np.array([[0.374, 0.621, 0.689], [-0.571, 0.277, 0.773]])


class SeenPoints(NamedTuple):
    """Points, and the instances that are visible to them.

    Attributes
    ----------
    points : Broadcast of float vectors, the file's coordinates
    masks : Broadcast of uint32, or None
        An instance is visible to a point if their masks share a bit; None: to all points.
    instance_ids : (n,) int, or None
        The only instances that are visible at all; None: all of them.
    """

    points: Broadcast
    masks: Broadcast | None
    instance_ids: NDArray[np.integer] | None

    @classmethod
    def read(cls, points: ArrayLike, mask: ArrayLike | None, instance_ids: NDArray[np.integer] | None) -> SeenPoints:
        """Return points with their masks, as the user gives them.

        Raises
        ------
        QueryError
            Wrong shapes, or masks that are no numbers of 32 bits.
        """
        read = read_points(points)
        return cls(read, None if mask is None else read_masks(mask, read.shape, "points"), instance_ids)

    def hidden(self) -> NDArray[np.bool_] | None:
        """Return which points do not see a mesh without instances, in their shape; None: all see it.

        It is instance 0, and every mask but 0 sees it.
        """
        shape = self.points.shape
        if self.instance_ids is not None and 0 not in self.instance_ids:
            return np.ones(shape, np.bool_)
        if self.masks is None:
            return None
        return np.broadcast_to(self.masks.items.reshape(() if self.masks.is_one else shape) == 0, shape)


def closest_points(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    shape, is_scene = seen.points.shape, not caster.world.is_lone
    with select_instances(caster, seen.instance_ids if is_scene else None) as selected:
        found = _find_points(selected, _SCENE_CLOSEST_POINT if is_scene else CLOSEST_POINT, seen, progress)
    distance, point = found.distance.reshape(shape), found.point.reshape(*shape, 3)
    prim_id, instance_id = found.prim_id.reshape(shape), found.instance_id.reshape(shape)
    if is_scene:
        geometry_id = np.full(shape, NO_PRIM, np.int32)
        is_found = instance_id != NO_PRIM
        geometry_id[is_found] = caster.world.arrays.geometry_id[instance_id[is_found]]
        return ClosestPoints(distance, point, prim_id, geometry_id, instance_id)
    hidden = seen.hidden()
    if hidden is None:
        return ClosestPoints(distance, point, prim_id)
    return ClosestPoints(
        np.where(hidden, np.inf, distance),
        np.where(hidden[..., None], np.nan, point),
        np.where(hidden, np.int32(NO_PRIM), prim_id),
    )


def is_contained(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether something visible contains each point; see `Tracer.contains`."""
    if not caster.world.is_lone:
        with select_instances(caster, seen.instance_ids) as selected:
            return _find_inside_instances(selected, seen, progress)
    inside, hidden = _find_inside(caster, seen.points, progress), seen.hidden()
    return inside if hidden is None else inside & ~hidden


def signed_distances(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    if not caster.world.is_lone:
        with select_instances(caster, seen.instance_ids) as selected:
            signed = -_find_points(selected, _SCENE_CLOSEST_POINT, seen, progress).distance
            depth = _find_points(selected, _DEPTH, seen, None)
        is_inside = depth.prim_id != NO_PRIM
        signed[is_inside] = depth.distance[is_inside]
        return signed.reshape(seen.points.shape)
    distance = closest_points(caster, seen, progress).distance
    return np.where(is_contained(caster, seen), distance, -distance)


def _find_inside(caster: Caster, points: Broadcast, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether each point is inside a closed mesh; see `Tracer.contains`."""
    check_room(math.prod(points.shape), 1, "points")
    box, is_inside = caster.world.box, np.zeros(math.prod(points.shape), np.bool_)
    with caster.open_call():  # refuses a closed tracer, even without points
        pass
    for begin, end in cut_points(len(is_inside), progress=progress):
        chunk = take_points(points, begin, end, box)
        in_box = np.flatnonzero((np.abs((chunk - box.centre) * box.scale) <= box.half).all(axis=1))
        rays, ray_shape = read_rays(chunk[in_box], GENERIC_DIRECTIONS[0], 0.0, np.inf)
        is_inside[begin + in_box] = count_hits(caster, rays, ray_shape, None, None) % 2 == 1
    return is_inside.reshape(points.shape)


@cut_smaller_when_full
def _find_inside_instances(caster: Caster, seen: SeenPoints, progress: Progress | None) -> NDArray[np.bool_]:
    """Return whether an instance of a scene contains each point."""
    count = math.prod(seen.points.shape)
    check_room(count, 1, "points")
    is_inside = np.empty(count, np.bool_)
    with caster.open_call() as call:
        for begin, chunk, order in _cut(call, seen.points, progress):
            with _cast(call, _INSIDE, seen.masks, begin, chunk, order) as inside:
                is_inside[begin + order] = inside
    return is_inside.reshape(seen.points.shape)


@contextmanager
def select_instances(caster: Caster, instance_ids: NDArray[np.integer] | None) -> Iterator[Caster]:
    """Give a caster at a scene of some of the instances; at all of them for None.

    Parameters
    ----------
    caster : Caster
        Of a `DeviceScene`.
    instance_ids : (n,) int, or None
    """
    if instance_ids is None:
        yield caster
        return
    world = caster.world
    assert world.top is not None
    # The call keeps the device open.
    with caster.open_call() as call:
        pruned = prune_top(world.top, instance_ids)
        buffers = {name: call.session.upload(array) for name, array in pruned.items()}
        yield caster.at(with_instances(world, buffers))


@cut_smaller_when_full
def _find_points(caster: Caster, query: Query, seen: SeenPoints, progress: Progress | None) -> FoundPoints:
    """Return the points of the primitives that a query finds, refined."""
    count = math.prod(seen.points.shape)
    check_room(count, _POINT_BYTES, "points")
    found, world = FoundPoints.make(count), caster.world
    with caster.open_call() as call:
        metrics, arguments = None, {}
        if world.metrics is not None:
            metrics, arguments["metrics"] = world.metrics.on(caster.session, call.session)
        for begin, chunk, order in _cut(call, seen.points, progress):
            part = found.part(begin, begin + len(chunk))
            with _cast(call, query, seen.masks, begin, chunk, order, **arguments) as prims:
                ranges = partial(_refine_range, chunk, world.arrays, metrics, world.box, order, prims, part)
                call.threads.for_ranges(len(chunk), ranges)
    return found


def _refine_range(
    chunk: NDArray[Any], arrays: Any, metrics: Any, box: TreeBox, order: NDArray[np.int32], prims: NDArray[Any],
    part: FoundPoints, first: int, last: int,
) -> None:  # fmt: skip
    refine_points(chunk, arrays, metrics, box, order[first:last], prims[first:last], part)


def _cut(
    call: Call, points: Broadcast, progress: Progress | None
) -> Iterator[tuple[int, NDArray[Any], NDArray[np.int32]]]:
    """Yield the begin of each chunk of points, the chunk, and the order in which to cast it."""
    for begin, end in cut_points_of(call, math.prod(points.shape), progress):
        chunk = take_points(points, begin, end, call.world.box)
        yield begin, chunk, find_point_order(chunk, call.world.box, call.threads)


@contextmanager
def _cast(
    call: Call,
    query: Query,
    masks: Broadcast | None,
    begin: int,
    chunk: NDArray[Any],
    order: NDArray[np.int32],
    **arguments: Any,
) -> Iterator[NDArray[Any]]:
    """Cast a chunk of points and give its results in the order of the cast, valid inside the block."""
    chunk_masks = take_masks(masks, begin, begin + len(chunk))

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        pack_points(chunk, chunk_masks, call.world.box, order[first:last], packed)

    with call.cast(query, put_points(call, len(chunk), pack), **arguments) as results:
        yield results

"""Points cast at a scene: the closest point of any surface, the inside of closed instances, and the depth in there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM, SCENE_PRIM
from ..launch import Call, Caster, Query
from ..less_memory import cut_smaller_when_full
from ..rays.broadcast import Broadcast
from ..rays.pieces import Progress
from ..room import check_room
from .order import find_point_order
from .pack import take_points
from .prune_top import prune_top
from .refine import SceneClosestPoints
from .scene_pack import pack_scene_points, take_masks
from .scene_refine import FoundPoints, refine_scene_points

CLOSEST_POINT = Query("closest_point", "prims", SCENE_PRIM)
INSIDE = Query("inside", "inside", np.dtype(np.uint8))
DEPTH = Query("depth", "prims", SCENE_PRIM)

# Distance, point and ids of a point.
_POINT_BYTES = 40


@cut_smaller_when_full
def find_scene_closest_points(
    caster: Caster, points: Broadcast, masks: Broadcast | None, progress: Progress | None = None
) -> SceneClosestPoints:
    """Return the closest points of the surfaces in a scene; see `Tracer.closest_point`."""
    found = _find_points(caster, CLOSEST_POINT, points, masks, progress)
    shape, geometry_id = points.shape, np.full(len(found.prim_id), NO_PRIM, np.int32)
    is_found = found.instance_id != NO_PRIM
    geometry_id[is_found] = caster.tree.surface.geometry_id[found.instance_id[is_found]]
    return SceneClosestPoints(
        found.distance.reshape(shape), found.point.reshape(*shape, 3), found.prim_id.reshape(shape),
        geometry_id.reshape(shape), found.instance_id.reshape(shape),
    )  # fmt: skip


@cut_smaller_when_full
def find_scene_inside(
    caster: Caster, points: Broadcast, masks: Broadcast | None, progress: Progress | None = None
) -> NDArray[np.bool_]:
    """Return whether an instance of a scene contains each point; see `Tracer.contains`."""
    count = math.prod(points.shape)
    check_room(count, 1, "points")
    is_inside = np.empty(count, np.bool_)
    with caster.open_call() as call:
        for begin, chunk, order in _cut(call, points, progress):
            with _cast(call, INSIDE, masks, begin, chunk, order) as inside:
                is_inside[begin + order] = inside
    return is_inside.reshape(points.shape)


@cut_smaller_when_full
def find_scene_signed_distance(
    caster: Caster, points: Broadcast, masks: Broadcast | None, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Return the signed distance to the surface of a scene; see `Tracer.signed_distance`."""
    signed = -_find_points(caster, CLOSEST_POINT, points, masks, progress).distance
    depth = _find_points(caster, DEPTH, points, masks, None)
    is_inside = depth.prim_id != NO_PRIM
    signed[is_inside] = depth.distance[is_inside]
    return signed.reshape(points.shape)


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
    scene: Any = caster.tree
    # The call keeps the device open.
    with caster.open_call() as call:
        pruned = prune_top(scene.top, instance_ids)
        selected = copy(scene)
        selected.arguments = scene.arguments | {
            name: call.memory.session.upload(array) for name, array in pruned.items()
        }
        yield caster.over(selected, caster.box)


def _find_points(
    caster: Caster, query: Query, points: Broadcast, masks: Broadcast | None, progress: Progress | None
) -> FoundPoints:
    """Return the points of the primitives that a query finds, refined."""
    count = math.prod(points.shape)
    check_room(count, _POINT_BYTES, "points")
    found, arrays = FoundPoints.make(count), caster.tree.surface
    with caster.open_call() as call:
        for begin, chunk, order in _cut(call, points, progress):
            part = found.part(begin, begin + len(chunk))
            with _cast(call, query, masks, begin, chunk, order) as prims:

                def refine(
                    first: int,
                    last: int,
                    chunk: NDArray[Any] = chunk,
                    order: NDArray[np.int32] = order,
                    prims: NDArray[np.void] = prims,
                    part: FoundPoints = part,
                ) -> None:
                    refine_scene_points(chunk, arrays, order[first:last], prims[first:last], part)

                call.threads.for_ranges(len(chunk), refine)
    return found


def _cut(
    call: Call, points: Broadcast, progress: Progress | None
) -> Iterator[tuple[int, NDArray[Any], NDArray[np.int32]]]:
    """Yield the begin of each chunk of points, the chunk, and the order in which to cast it."""
    for begin, end in call.cut_points(math.prod(points.shape), progress):
        chunk = take_points(points, begin, end, call.box)
        yield begin, chunk, find_point_order(chunk, call.box, call.threads)


@contextmanager
def _cast(
    call: Call, query: Query, masks: Broadcast | None, begin: int, chunk: NDArray[Any], order: NDArray[np.int32]
) -> Iterator[NDArray[Any]]:
    """Cast a chunk of points and give its results in the order of the cast, valid inside the block."""
    chunk_masks = take_masks(masks, begin, begin + len(chunk))

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        pack_scene_points(chunk, chunk_masks, call.box, order[first:last], packed)

    with call.cast(query, call.pack_points(len(chunk), pack)) as results:
        yield results

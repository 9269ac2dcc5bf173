"""The queries of points: the closest points of what is visible, all of them that are near, and what contains them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...structs import NO_PRIM, WORLD_PRIM
from ..hits.surface import Surface
from ..launch import Caster
from ..rays.batch import check_room
from ..rays.pieces import Progress
from . import search
from .batch import SeenPoints
from .refine import AllClosestPoints, ClosestPoints, FoundPoints, refine_points
from .search import CLOSEST_POINT, DEPTH, Points, look_up

# Distance, point, u, v and ids of a point.
POINT_BYTES = 56

# Slots of each point beside those that are asked for: about as many triangles meet at a vertex, and are equally near.
# Where they are too few, the slots grow by a factor.
_SPARE_SLOTS = 8
_SLOT_GROWTH = 4

# By how much of its size, and of the world's, a box is grown: more than float32 rounds.
_BOX_ROOM = 2.0**-18

_BOXES = Loops("points/boxes")


def find_closest(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    if caster.world.is_exact:
        # Float64 decides.
        return find_nearest(caster, seen, 1, progress).as_closest(seen.shape, Surface.of_world(caster.world))
    check_room(seen.count, POINT_BYTES, "points")
    found = FoundPoints.make(seen.count)
    look_up(caster, seen, lambda points: points.find(CLOSEST_POINT, _part_of(found, points)), progress)
    found.drop_beyond(seen.limits, seen.shape)
    return found.as_closest(seen.shape, Surface.of_world(caster.world))


def find_contained(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether something visible contains each point; see `Tracer.contains`."""
    check_room(seen.count, 1, "points")
    is_inside = np.empty(seen.count, np.bool_)

    def find(points: Points) -> None:
        is_inside[points.piece.begin : points.piece.end] = points.find_inside()

    look_up(caster, seen, find, progress)
    return is_inside.reshape(seen.shape)


def find_signed(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    check_room(seen.count, POINT_BYTES, "points")
    if caster.world.is_exact:
        return _find_exact_signed(caster, seen, progress)
    is_lone, signed, found = caster.world.is_lone, np.empty(seen.count), FoundPoints.make(seen.count)

    def find(points: Points) -> None:
        near, own = _part_of(found, points), signed[points.piece.begin : points.piece.end]
        points.find(CLOSEST_POINT, near)
        own[:] = -near.distance
        if is_lone:
            is_inside = points.find_inside()
        else:
            points.find(DEPTH, near)
            is_inside = near.prim_id != NO_PRIM
        own[is_inside] = near.distance[is_inside]

    look_up(caster, seen, find, progress)
    return signed.reshape(seen.shape)


def _find_exact_signed(caster: Caster, seen: SeenPoints, progress: Progress | None) -> NDArray[np.float64]:
    signed = -find_closest(caster, seen, progress).distance.reshape(-1)
    if caster.world.is_lone:
        deepest = np.where(find_contained(caster, seen).reshape(-1), 0, NO_PRIM)
    else:
        # Float32 chooses among instances that are about as deep; the depth is that of the one that it has chosen.
        found = FoundPoints.make(seen.count)
        look_up(caster, seen, lambda points: points.find(DEPTH, _part_of(found, points)))
        deepest = found.instance_id
    for instance_id in np.unique(deepest[deepest != NO_PRIM]):
        here = np.flatnonzero(deepest == instance_id)
        inside = SeenPoints(seen.take(here).points, instance_ids=np.array([instance_id]))
        signed[here] = find_nearest(caster, inside, 1).distance
    return signed.reshape(seen.shape)


def find_nearest_points(
    caster: Caster, seen: SeenPoints, count: int, progress: Progress | None = None
) -> ClosestPoints:
    """Return the nearest primitives of what is visible, as many as are asked for; see `Tracer.closest_points`.

    A kernel keeps a few more than that for each point, by a lower bound on their distances, which it knows to float32.
    The nearest are chosen in float64, and looked for again, with more room, wherever one that was left out might be as
    near as the last one.
    """
    found = find_nearest(caster, seen, count, progress)
    return found.as_closest((*seen.shape, count), Surface.of_world(caster.world))


def find_nearest(caster: Caster, seen: SeenPoints, count: int, progress: Progress | None = None) -> FoundPoints:
    """Return the same, `count` results of each point."""
    check_room(seen.count, count * POINT_BYTES, "points")
    found, slots = FoundPoints.make(seen.count * count), count + _SPARE_SLOTS

    def find(points: Points) -> None:
        begin, end = points.piece.begin, points.piece.end
        _choose(points, count, slots, found.part(begin * count, end * count))

    look_up(caster, seen, find, progress, most_points=max(1, search.MOST_SLOTS // slots))
    found.drop_beyond(seen.limits, seen.shape, count)
    return found


def find_within(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> AllClosestPoints:
    """Return all primitives within the limits of the points; see `Tracer.prims_within`."""

    def find(ids: NDArray[np.int64], slots: int) -> tuple[NDArray[np.int32], FoundPoints]:
        found = find_nearest(caster, seen.take(ids), slots)
        return found.prim_id, found

    point_ids, parts = _find_all(seen.count, find, progress)
    order = np.argsort(point_ids, kind="stable")
    found = FoundPoints(*map(np.concatenate, zip(*parts, strict=True))).take(order)
    closest = found.as_closest((len(order),), Surface.of_world(caster.world))
    return AllClosestPoints._of(closest, np.bincount(point_ids, minlength=seen.count))


def find_in_boxes(
    caster: Caster, lower: NDArray[np.float64], upper: NDArray[np.float64], seen: SeenPoints,
    progress: Progress | None = None,
) -> AllClosestPoints:  # fmt: skip
    """Return the primitives that meet boxes, of which `seen` has the middles; see `Tracer.prims_in_boxes`.

    The device finds those whose own boxes do, in float32; then each is tested in float64.
    """
    world = caster.world
    # What is outside of the world's box does not matter, and float32 could not hold it.
    reach = world.box.half * (1 + _BOX_ROOM) / world.box.scale
    least, most = np.maximum(lower, world.box.centre - reach), np.minimum(upper, world.box.centre + reach)
    half_sides = ((most - least) / 2 * world.box.scale * (1 + _BOX_ROOM) + _BOX_ROOM).astype(np.float32)
    inside = SeenPoints((least + most) / 2, seen.masks, seen.instance_ids, np.zeros(()))
    met = np.flatnonzero((least <= most).all(axis=1))

    def find(ids: NDArray[np.int64], slots: int) -> tuple[NDArray[np.int32], NDArray[np.void]]:
        hits, own = np.empty((len(ids), slots), world.hit_dtype), half_sides[met[ids]]

        def write(points: Points) -> None:
            for piece in points.piece.split(points.find_room(slots)):
                rows = piece.begin + piece.item_ids()
                hits[rows] = points._replace(piece=piece).find_in_boxes(own, slots)

        look_up(caster, inside.take(met[ids]), write)
        return hits["prim_id"].reshape(-1), hits.reshape(-1)

    found_ids, parts = _find_all(len(met), find, progress)
    box_ids, hits = met[found_ids], np.concatenate(parts)
    prims = np.zeros(len(hits), WORLD_PRIM)
    prims["prim_id"], prims["instance_id"] = hits["prim_id"], 0 if world.is_lone else hits["instance_id"]
    is_met = np.empty(len(prims), np.bool_)

    def test(begin: int, end: int) -> None:
        rows = slice(begin, end)
        _BOXES.meet_boxes(world.arrays.addresses, least, most, box_ids[rows], prims[rows], is_met[rows])

    caster.threads.for_ranges(len(prims), test)
    box_ids, prims = box_ids[is_met], prims[is_met]

    found, slots = FoundPoints.make(len(prims)), np.arange(len(prims), dtype=np.int32)
    middles = np.where(np.isfinite(seen.points), seen.points, inside.points)

    def refine(begin: int, end: int) -> None:
        of_world, rows = (world.arrays, world.metrics.metrics, world.box), slice(begin, end)
        refine_points(middles, *of_world, box_ids[rows].astype(np.int32), prims[rows], found, slots[rows])

    caster.threads.for_ranges(len(prims), refine)
    order = np.lexsort((found.prim_id, found.instance_id, found.distance, box_ids))
    closest = found.take(order).as_closest((len(order),), Surface.of_world(world))
    return AllClosestPoints._of(closest, np.bincount(box_ids, minlength=len(lower)))


class _Results(Protocol):
    """Results of which some can be taken, by their numbers."""

    def take(self, rows: NDArray[np.int64], /) -> Any: ...


def _find_all(
    count: int, find: Callable[[NDArray[np.int64], int], tuple[NDArray[np.int32], _Results]], progress: Progress | None
) -> tuple[NDArray[np.int64], list[Any]]:
    """Return all primitives that are found for points or boxes: whose each of them is, and parts of the results.

    A few are looked for, and four times as many where all slots are taken, until none has more.

    Parameters
    ----------
    count : int
    find : function
        Called with the numbers of some of the points, and a number of slots; returns what is in the slots of each, a
        prim_id, and the results.
    progress : function, optional
    """
    left, slots, owners = np.arange(count), _SPARE_SLOTS, []
    parts: list[Any] = []
    while len(left) or not parts:
        step, crowded = max(1, search.MOST_SLOTS // slots), [left[:0]]
        for begin in range(0, max(1, len(left)), step):
            ids = left[begin : begin + step]
            prims, results = find(ids, slots)
            is_there = prims.reshape(-1, slots) != NO_PRIM
            is_full = is_there[:, -1]
            rows = np.flatnonzero(is_there & ~is_full[:, None])
            owners.append(ids[rows // slots])
            parts.append(results.take(rows))
            crowded.append(ids[is_full])
            if progress is not None and slots == _SPARE_SLOTS:
                progress(begin + len(ids), count)
        left, slots = np.concatenate(crowded), slots * _SLOT_GROWTH
    return np.concatenate(owners), parts


def _choose(points: Points, count: int, slots: int, found: FoundPoints) -> None:
    for piece in points.piece.split(points.find_room(slots)):
        crowded = points._replace(piece=piece).choose(count, slots, found)
        if len(crowded):
            _choose(points._replace(piece=piece.only(crowded)), count, slots * _SLOT_GROWTH, found)


def _part_of(found: FoundPoints, points: Points) -> FoundPoints:
    return found.part(points.piece.begin, points.piece.end)

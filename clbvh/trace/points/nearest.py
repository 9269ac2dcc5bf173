"""The nearest primitives of points, as many as are asked for.

The device keeps a few more than that for each point, by a lower bound on their distances, which it knows to float32.
The host computes their distances in float64, and searches again, with more room, wherever one that the device has left
out might be as near as the last one.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM
from ..launch import Call, Caster, Query
from ..rays.batch import check_room
from ..rays.pieces import Progress
from .pack import FAR_SHARE, pack_points
from .queries import (
    POINT_BYTES,
    Piece,
    Search,
    SeenPoints,
    at_chosen_instances,
    cut_pieces,
    find_closest_points,
    find_contained,
    find_deepest_instances,
    find_in_box,
    find_signed_distances,
)
from .refine import ClosestPoints, FoundPoints

_CLOSEST_POINTS = Query("closest_points", "hits")

# Slots on the device at a time. A single point gets the room it needs.
_MOST_SLOTS = 2**20

# Slots of each point beside those that are asked for: about as many triangles meet at a vertex, and are equally near.
# Where they are too few, the slots grow by a factor.
_SPARE_SLOTS = 8
_SLOT_GROWTH = 4

# Distances that differ by less than this share of themselves and of the point's coordinates are ties: float64 rounds
# those of triangles that share an edge by less than that, each in its own way.
_TIE_SHARE = 2.0**-46


def find_nearest_points(
    caster: Caster, seen: SeenPoints, count: int, progress: Progress | None = None
) -> ClosestPoints:
    """Return the nearest primitives of what is visible; see `Tracer.closest_points`."""
    check_room(seen.point_count, count * POINT_BYTES, "points")
    found, slots = FoundPoints.make(seen.point_count * count), count + _SPARE_SLOTS

    @at_chosen_instances
    def cast(seen: SeenPoints, call: Call) -> None:
        search = Search.begin(call)
        for piece in cut_pieces(call, seen, progress, most_points=max(1, _MOST_SLOTS // slots)):
            _search(search, piece, count, slots, found.part(piece.begin * count, piece.end * count))

    caster.run(partial(cast, seen))
    return found.as_closest((*seen.points.shape, count), caster.world.arrays.geometry_id)


def find_closest(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    if not caster.world.is_exact:
        return find_closest_points(caster, seen, progress)
    distance, point, prim_id = closest = find_nearest_points(caster, seen, 1, progress)
    return ClosestPoints(
        distance[..., 0], point[..., 0, :], prim_id[..., 0], closest.geometry_id[..., 0], closest.instance_id[..., 0]
    )


def find_signed(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    if not caster.world.is_exact:
        return find_signed_distances(caster, seen, progress)
    signed = -find_closest(caster, seen, progress).distance.reshape(-1)
    if caster.world.is_lone:
        deepest = np.where(find_contained(caster, seen).reshape(-1), 0, NO_PRIM)
    else:
        # Float32 chooses among instances that are about as deep; the depth is that of the one that it has chosen.
        deepest = find_deepest_instances(caster, seen)
    for instance_id in np.unique(deepest[deepest != NO_PRIM]):
        here = np.flatnonzero(deepest == instance_id)
        inside = SeenPoints(seen.points.take(here), None, np.array([instance_id]))
        signed[here] = find_nearest_points(caster, inside, 1).distance[:, 0]
    return signed.reshape(seen.points.shape)


def _search(search: Search, piece: Piece, count: int, slots: int, found: FoundPoints) -> None:
    """Write the nearest primitives of the points in the order of a piece."""
    most_points = max(1, search.call.fit(search.call.world.hit_dtype, _MOST_SLOTS) // slots)
    for begin in range(0, len(piece.order), most_points):
        batch = piece._replace(order=piece.order[begin : begin + most_points])
        crowded = _search_batch(search, batch, count, slots, found)
        if len(crowded):
            _search(search, piece._replace(order=crowded), count, slots * _SLOT_GROWTH, found)


def _search_batch(search: Search, piece: Piece, count: int, slots: int, found: FoundPoints) -> NDArray[np.int32]:
    """Write the nearest primitives of points, and return those whose slots are too few."""
    call, points, order = search.call, piece.points, piece.order
    candidates = FoundPoints.make(len(order) * slots)
    batch = pack_points(call, points, piece.masks, order)
    with call.cast(
        _CLOSEST_POINTS, batch, results_per_item=slots, slots=np.int32(slots), is_single=np.int32(count == 1),
        metrics=search.buffer,
    ) as hits:  # fmt: skip
        search.refine(points, np.repeat(order, slots), hits, candidates, np.arange(len(hits), dtype=np.int32))
        is_crowded = hits["prim_id"][slots - 1 :: slots] != NO_PRIM
        # Nothing that is left out is nearer than this.
        least_left = hits["t"][::slots] / call.world.box.scale
    # Others are not where they are for the device.
    is_crowded &= find_in_box(points, call.world.box, FAR_SHARE * call.world.box.half.max())[order]

    def rank(begin: int, end: int) -> None:
        part, chosen = candidates.part(begin * slots, end * slots), order[begin:end]
        is_crowded[begin:end] &= least_left[begin:end] <= _write_nearest(part, points[chosen], count, chosen, found)

    call.threads.for_ranges(len(order), rank)
    return order[is_crowded]


def _write_nearest(
    candidates: FoundPoints, points: NDArray[np.floating], count: int, rows: NDArray[np.int32], found: FoundPoints
) -> NDArray[np.float64]:
    """Write the nearest candidates of points to rows of `found`; return the distances up to which others matter."""
    shape = len(points), -1
    by_distance = np.argsort(candidates.distance.reshape(shape), axis=1)
    distance = np.take_along_axis(candidates.distance.reshape(shape), by_distance, axis=1)
    prim = np.take_along_axis(candidates.prim_id.reshape(shape), by_distance, axis=1)
    instance = np.take_along_axis(candidates.instance_id.reshape(shape), by_distance, axis=1)
    slack = _TIE_SHARE * (np.abs(points).max(axis=1).astype(np.float64)[:, None] + distance)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        is_farther = np.diff(distance, axis=1) > slack[:, :-1]
    # Ties have one number, and are in the order of instances and primitives.
    numbers = np.zeros(distance.shape, np.int32)
    np.cumsum(is_farther, axis=1, out=numbers[:, 1:])
    ranks = np.lexsort((prim, instance, numbers), axis=1)[:, :count]
    chosen = np.take_along_axis(by_distance, ranks, axis=1)
    taken = np.arange(len(points))[:, None] * distance.shape[1] + chosen
    found.point.reshape(-1, count, 3)[rows] = candidates.point[taken]
    found.prim_id.reshape(-1, count)[rows] = candidates.prim_id[taken]
    found.instance_id.reshape(-1, count)[rows] = candidates.instance_id[taken]
    # In ascending order: those of ties differ by their rounding alone.
    found.distance.reshape(-1, count)[rows] = distance[:, :count]
    return distance[:, count - 1] + slack[:, count - 1]

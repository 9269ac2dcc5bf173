"""The queries of points: the closest points of what is visible, and what contains them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM
from ..launch import Caster
from ..rays.batch import check_room
from ..rays.pieces import Progress
from . import search
from .batch import SeenPoints
from .refine import ClosestPoints, FoundPoints
from .search import CLOSEST_POINT, DEPTH, Points, look_up

# Distance, point and ids of a point.
POINT_BYTES = 40

# Slots of each point beside those that are asked for: about as many triangles meet at a vertex, and are equally near.
# Where they are too few, the slots grow by a factor.
_SPARE_SLOTS = 8
_SLOT_GROWTH = 4


def find_closest(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    if caster.world.is_exact:
        # Float64 decides.
        distance, point, prim_id = closest = find_nearest_points(caster, seen, 1, progress)
        ids = closest.geometry_id[..., 0], closest.instance_id[..., 0]
        return ClosestPoints(distance[..., 0], point[..., 0, :], prim_id[..., 0], *ids)
    check_room(seen.count, POINT_BYTES, "points")
    found = FoundPoints.make(seen.count)
    look_up(caster, seen, lambda points: points.find(CLOSEST_POINT, _part_of(found, points)), progress)
    return found.as_closest(seen.shape, caster.world.arrays.geometry_id)


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
        inside = SeenPoints(seen.rows.take(here).items, instance_ids=np.array([instance_id]))
        signed[here] = find_nearest_points(caster, inside, 1).distance[:, 0]
    return signed.reshape(seen.shape)


def find_nearest_points(
    caster: Caster, seen: SeenPoints, count: int, progress: Progress | None = None
) -> ClosestPoints:
    """Return the nearest primitives of what is visible, as many as are asked for; see `Tracer.closest_points`.

    A kernel keeps a few more than that for each point, by a lower bound on their distances, which it knows to float32.
    The nearest are chosen in float64, and looked for again, with more room, wherever one that was left out might be as
    near as the last one.
    """
    check_room(seen.count, count * POINT_BYTES, "points")
    found, slots = FoundPoints.make(seen.count * count), count + _SPARE_SLOTS

    def find(points: Points) -> None:
        begin, end = points.piece.begin, points.piece.end
        _choose(points, count, slots, found.part(begin * count, end * count))

    look_up(caster, seen, find, progress, most_points=max(1, search.MOST_SLOTS // slots))
    return found.as_closest((*seen.shape, count), caster.world.arrays.geometry_id)


def _choose(points: Points, count: int, slots: int, found: FoundPoints) -> None:
    for piece in points.piece.split(points.find_room(slots)):
        crowded = points._replace(piece=piece).choose(count, slots, found)
        if len(crowded):
            _choose(points._replace(piece=piece.only(crowded)), count, slots * _SLOT_GROWTH, found)


def _part_of(found: FoundPoints, points: Points) -> FoundPoints:
    return found.part(points.piece.begin, points.piece.end)

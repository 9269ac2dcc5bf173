"""The queries of points: what is visible to them, how they are cast, and what the answers are where nothing is."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import NO_PRIM, PACKED_POINT, WORLD_PRIM
from ..launch import Batch, Call, Caster, Query
from ..rays.batch import Broadcast, check_room, read_masks, read_points
from ..rays.pieces import CHUNK_RAYS, Progress
from ..world.metrics import Metrics
from ..world.top_tree import prune_top
from ..world.tree_box import TreeBox
from ..world.world import with_instances
from .pack import cut_points_of, find_point_order, pack_points, take_masks, take_points
from .refine import ClosestPoints, FoundPoints, refine_points

CLOSEST_POINT = Query("closest_point", "prims", WORLD_PRIM)
_INSIDE = Query("inside", "is_inside", np.dtype(np.uint8))
_DEPTH = Query("depth", "prims", WORLD_PRIM)

# Distance, point and ids of a point.
POINT_BYTES = 40

# Directions along which crossings are counted, in this order of preference. Any will do: a direction that no mesh is
# modelled along meets few edges exactly, where the traversal has the most to do.
GENERIC_DIRECTIONS = np.array([[0.374, 0.621, 0.689], [-0.571, 0.277, 0.773]])

# Nothing contains points out of the box, which float32 has rounded.
_BOX_GROWTH = 1 + 2.0**-20

_NOTHING_VISIBLE = Broadcast.to_shape(np.zeros((), np.uint32), 0, ())


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

    @property
    def point_count(self) -> int:
        """Number of points."""
        return math.prod(self.points.shape)


class Piece(NamedTuple):
    """Points `begin` to `end` of a query.

    Attributes
    ----------
    begin, end : int
    points : (n, 3) float, contiguous, the world's coordinates
    masks : (n,) or (1,) uint32
    order : (n,) int32
        In which to cast them.
    """

    begin: int
    end: int
    points: NDArray[Any]
    masks: NDArray[np.uint32]
    order: NDArray[np.int32]


class Search(NamedTuple):
    """A call with what the search for near primitives needs of the world."""

    call: Call
    metrics: Metrics
    buffer: Any

    @classmethod
    def begin(cls, call: Call) -> Search:
        """Return the search of a call that is open."""
        return cls(call, *call.world.metrics.on(call.caster.session, call.session))

    def find(self, query: Query, piece: Piece, batch: Batch, found: FoundPoints, **arguments: Any) -> None:
        """Write the points of the primitives that a query finds."""
        with self.call.cast(query, batch, metrics=self.buffer, **arguments) as prims:
            self.refine(piece.points, piece.order, prims, found, piece.order)

    def refine(
        self, points: NDArray[Any], order: NDArray[np.int32], prims: NDArray[Any], found: FoundPoints,
        slots: NDArray[np.int32],
    ) -> None:  # fmt: skip
        """Write the points of primitives in parallel; see `refine_points`."""
        world = self.call.world

        def refine(first: int, last: int) -> None:
            refine_points(
                points, world.arrays, self.metrics, world.box, order[first:last], prims[first:last], found,
                slots[first:last],
            )  # fmt: skip

        self.call.threads.for_ranges(len(order), refine)


def at_chosen_instances(cast: Callable[..., None]) -> Callable[..., None]:
    """Decorate a function of a call and `SeenPoints`: its call is at the world of the chosen instances alone."""

    @functools.wraps(cast)
    def cast_chosen(seen: SeenPoints, call: Call) -> None:
        world, chosen = call.world, seen.instance_ids
        if chosen is not None and world.is_lone:
            seen = seen._replace(masks=seen.masks if 0 in chosen else _NOTHING_VISIBLE)
        elif chosen is not None:
            assert world.top is not None
            buffers = {name: call.session.upload(array) for name, array in prune_top(world.top, chosen).items()}
            call = call.at(with_instances(world, buffers))
        cast(seen, call)

    return cast_chosen


def find_closest_points(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    check_room(seen.point_count, POINT_BYTES, "points")
    found = FoundPoints.make(seen.point_count)

    @at_chosen_instances
    def cast(seen: SeenPoints, call: Call) -> None:
        search = Search.begin(call)
        for piece in cut_pieces(call, seen, progress):
            batch = pack_points(call, piece.points, piece.masks, piece.order)
            search.find(CLOSEST_POINT, piece, batch, found.part(piece.begin, piece.end))

    caster.run(partial(cast, seen))
    return found.as_closest(seen.points.shape, caster.world.arrays.geometry_id)


def find_contained(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether something visible contains each point; see `Tracer.contains`."""
    check_room(seen.point_count, 1, "points")
    is_inside = np.zeros(seen.point_count, np.bool_)

    @at_chosen_instances
    def cast(seen: SeenPoints, call: Call) -> None:
        box = call.world.box
        for piece in cut_pieces(call, seen, progress):
            order = piece.order[find_in_box(piece.points, box, box.half * _BOX_GROWTH)[piece.order]]
            if len(order):
                with _cast_inside(call, pack_points(call, piece.points, piece.masks, order)) as inside:
                    is_inside[piece.begin + order] = inside

    caster.run(partial(cast, seen))
    return is_inside.reshape(seen.points.shape)


def find_signed_distances(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    check_room(seen.point_count, POINT_BYTES, "points")
    signed, found = np.empty(seen.point_count), FoundPoints.make(seen.point_count)

    @at_chosen_instances
    def cast(seen: SeenPoints, call: Call) -> None:
        search, box = Search.begin(call), call.world.box
        for piece in cut_pieces(call, seen, progress):
            near, own = found.part(piece.begin, piece.end), signed[piece.begin : piece.end]
            batch = pack_points(call, piece.points, piece.masks, piece.order)
            search.find(CLOSEST_POINT, piece, batch, near)
            own[:] = -near.distance
            if not call.world.is_lone:
                search.find(_DEPTH, piece, batch, near, **_put_surplus(call))
                is_inside = near.prim_id != NO_PRIM
            else:
                is_inside = find_in_box(piece.points, box, box.half * _BOX_GROWTH)
                with _cast_inside(call, batch) as inside:
                    is_inside[piece.order] &= inside.view(np.bool_)
            own[is_inside] = near.distance[is_inside]

    caster.run(partial(cast, seen))
    return signed.reshape(seen.points.shape)


def find_deepest_instances(caster: Caster, seen: SeenPoints) -> NDArray[np.int32]:
    """Return (n,) int32: of the visible instances that contain a point, the deepest around it; `NO_PRIM` where none."""
    deepest = np.empty(seen.point_count, np.int32)

    @at_chosen_instances
    def cast(seen: SeenPoints, call: Call) -> None:
        search = Search.begin(call)
        for piece in cut_pieces(call, seen, None):
            batch = pack_points(call, piece.points, piece.masks, piece.order)
            with call.cast(_DEPTH, batch, metrics=search.buffer, **_put_surplus(call)) as prims:
                deepest[piece.begin + piece.order] = prims["instance_id"]

    caster.run(partial(cast, seen))
    return deepest


def _cast_inside(call: Call, batch: Batch) -> AbstractContextManager[NDArray[Any]]:
    return call.cast(_INSIDE, batch, **_put_surplus(call))


def _put_surplus(call: Call) -> dict[str, Any]:
    """Return the arguments of cl/world/inside.cl that say which faces do not count."""
    surplus = call.world.surplus
    names = ("surplus", "first_surplus")
    return dict.fromkeys(names) if surplus is None else {n: call.put(n, a) for n, a in zip(names, surplus, strict=True)}


def cut_pieces(
    call: Call, seen: SeenPoints, progress: Progress | None, *, most_points: int = CHUNK_RAYS
) -> Iterator[Piece]:
    """Yield the pieces in which to cast the points."""
    box = call.world.box
    for begin, end in cut_points_of(call, PACKED_POINT, seen.point_count, progress, most_points=most_points):
        points, masks = take_points(seen.points, begin, end, box), take_masks(seen.masks, begin, end)
        yield Piece(begin, end, points, masks, find_point_order(points, box, call.order_by_keys))


def find_in_box(points: NDArray[Any], box: TreeBox, half: ArrayLike) -> NDArray[np.bool_]:
    """Return which points are in a box of half this size, in local units, around the middle of the world."""
    return np.logical_and.reduce(np.abs((points - box.centre) * box.scale) <= half, axis=1)

"""The queries of points: what is visible to them, how they are cast, and what the answers are where nothing is."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import NO_PRIM, PACKED_POINT, WORLD_PRIM
from ..hits.closest import count_hits
from ..launch import Batch, Call, Caster, Query, cut_smaller_when_full
from ..rays.batch import Broadcast, check_room, read_masks, read_points, read_rays
from ..rays.pieces import CHUNK_RAYS, Progress
from ..world.metrics import Metrics
from ..world.top_tree import prune_top
from ..world.tree_box import TreeBox
from ..world.world import with_instances
from .pack import cut_points_of, find_point_order, pack_points, take_masks, take_points
from .refine import ClosestPoints, FoundPoints, refine_points

_Result = TypeVar("_Result")

CLOSEST_POINT = Query("closest_point", "prims", WORLD_PRIM)
_INSIDE = Query("inside", "inside", np.dtype(np.uint8))
_DEPTH = Query("depth", "prims", WORLD_PRIM)

# Distance, point and ids of a point.
POINT_BYTES = 40

# Directions along which crossings are counted, in this order of preference. Any will do: a direction that no mesh is
# modelled along meets few edges exactly, where the traversal has the most to do.
GENERIC_DIRECTIONS = np.array([[0.374, 0.621, 0.689], [-0.571, 0.277, 0.773]])

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
    def begin(cls, caster: Caster, call: Call) -> Search:
        """Return the search of a call that is open."""
        return cls(call, *caster.world.metrics.on(caster.session, call.session))

    def find(self, query: Query, piece: Piece, batch: Batch, found: FoundPoints) -> None:
        """Write the points of the primitives that a query finds."""
        with self.call.cast(query, batch, metrics=self.buffer) as prims:
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


def at_chosen_instances(query: Callable[..., _Result]) -> Callable[..., _Result]:
    """Decorate a query of a caster and `SeenPoints`: its caster is at the world of the chosen instances alone."""

    @functools.wraps(query)
    def ask(caster: Caster, seen: SeenPoints, *arguments: Any) -> _Result:
        if seen.instance_ids is None:
            return query(caster, seen, *arguments)
        if caster.world.is_lone:
            masks = seen.masks if 0 in seen.instance_ids else _NOTHING_VISIBLE
            return query(caster, seen._replace(masks=masks), *arguments)
        with select_instances(caster, seen.instance_ids) as selected:
            return query(selected, seen, *arguments)

    return ask


@contextmanager
def select_instances(caster: Caster, instance_ids: NDArray[np.integer]) -> Iterator[Caster]:
    """Give a caster at some of the instances of a scene."""
    world = caster.world
    assert world.top is not None
    # The call keeps the device open.
    with caster.open_call() as call:
        buffers = {name: call.session.upload(array) for name, array in prune_top(world.top, instance_ids).items()}
        yield caster.at(with_instances(world, buffers))


@at_chosen_instances
@cut_smaller_when_full
def find_closest_points(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    check_room(seen.point_count, POINT_BYTES, "points")
    found = FoundPoints.make(seen.point_count)
    with caster.open_call() as call:
        search = Search.begin(caster, call)
        for piece in cut_pieces(call, seen, progress):
            batch = pack_points(call, piece.points, piece.masks, piece.order)
            search.find(CLOSEST_POINT, piece, batch, found.part(piece.begin, piece.end))
    return found.as_closest(seen.points.shape, caster.world.arrays.geometry_id)


@at_chosen_instances
@cut_smaller_when_full
def find_contained(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether something visible contains each point; see `Tracer.contains`."""
    check_room(seen.point_count, 1, "points")
    is_inside, box = np.zeros(seen.point_count, np.bool_), caster.world.box  # nothing contains points out of the box
    with caster.open_call() as call:
        for piece in cut_pieces(call, seen, progress):
            order = piece.order[find_in_box(piece.points, box, box.half)[piece.order]]
            if call.on_host(len(order)):
                rays, shape = read_rays(piece.points[order], GENERIC_DIRECTIONS[0], 0.0, np.inf)
                is_odd = count_hits(caster, rays, shape, None, None) % 2 == 1
                is_inside[piece.begin + order] = is_odd & (piece.masks[order if len(piece.masks) > 1 else 0] != 0)
            elif len(order):
                with call.cast(_INSIDE, pack_points(call, piece.points, piece.masks, order)) as inside:
                    is_inside[piece.begin + order] = inside
    return is_inside.reshape(seen.points.shape)


@at_chosen_instances
@cut_smaller_when_full
def find_signed_distances(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    check_room(seen.point_count, POINT_BYTES, "points")
    signed, found, box = np.empty(seen.point_count), FoundPoints.make(seen.point_count), caster.world.box
    with caster.open_call() as call:
        search = Search.begin(caster, call)
        for piece in cut_pieces(call, seen, progress):
            part, own = found.part(piece.begin, piece.end), signed[piece.begin : piece.end]
            batch = pack_points(call, piece.points, piece.masks, piece.order)
            search.find(CLOSEST_POINT, piece, batch, part)
            own[:] = -part.distance
            if not caster.world.is_lone:
                search.find(_DEPTH, piece, batch, part)
                is_inside = part.prim_id != NO_PRIM
            else:
                is_inside = find_in_box(piece.points, box, box.half)
                with call.cast(_INSIDE, batch) as inside:
                    is_inside[piece.order] &= inside.view(np.bool_)
            own[is_inside] = part.distance[is_inside]
    return signed.reshape(seen.points.shape)


def cut_pieces(
    call: Call, seen: SeenPoints, progress: Progress | None, *, most_points: int = CHUNK_RAYS
) -> Iterator[Piece]:
    """Yield the pieces in which to cast points."""
    box = call.world.box
    for begin, end in cut_points_of(call, PACKED_POINT, seen.point_count, progress, most_points=most_points):
        points, masks = take_points(seen.points, begin, end, box), take_masks(seen.masks, begin, end)
        yield Piece(begin, end, points, masks, find_point_order(points, box, call.order_by_keys))


def find_in_box(points: NDArray[Any], box: TreeBox, half: ArrayLike) -> NDArray[np.bool_]:
    """Return which points are in a box of half this size, in local units, around the middle of the world."""
    return np.logical_and.reduce(np.abs((points - box.centre) * box.scale) <= half, axis=1)

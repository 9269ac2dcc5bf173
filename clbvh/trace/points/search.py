"""Points are looked up piece by piece: on the host where they are, on other devices packed, in a coherent order.

A query is a function that is called with each piece, a `HostPoints` or a `DevicePoints`. Both have the same methods,
whose answers have the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.library import find_addresses
from ...structs import PACKED_POINT, WORLD_PRIM
from ..host_items import ALL_GOOD, HostItems, begin_at
from ..launch import Batch, Call, Caster, Query, run_pieces
from ..rays import pieces
from ..rays.batch import check_room
from ..rays.pieces import Piece, Progress
from ..world.metrics import Metrics
from ..world.surface_arrays import SurfaceArrays
from ..world.top_tree import prune_top
from ..world.tree_box import TreeBox
from ..world.world import World, with_instances
from . import pack
from .batch import SeenPoints, explain_bad_point, take_points
from .refine import FoundPoints, choose_points, refine_points

CLOSEST_POINT = Query("closest_point", "prims", WORLD_PRIM)
DEPTH = Query("depth", "prims", WORLD_PRIM)
_INSIDE = Query("inside", "is_inside", np.dtype(np.uint8))
_CLOSEST_POINTS = Query("closest_points", "hits")
_PRIMS_IN_BOXES = Query("prims_in_boxes", "hits")

# The box is grown by this share before a point is said to be outside: float32 has rounded it. As in
# cl/on_host/world/points.cl.
_BOX_GROWTH = 1 + 2.0**-20

# Slots of the points that are looked up at a time. A single point gets the room it needs.
MOST_SLOTS = 2**20

# Points of a work-group on the host. Looking one up takes as long as 5 to 50 rays.
_GROUP_POINTS = 16

# A number and two ids of a primitive, see cl/nearest/choose.cl; and the bytes of these and of a hit.
_CANDIDATE_NUMBERS = 2
_SLOT_BYTES = 40

_NO_POINTS = np.empty(0, np.int32)


class HostPoints(NamedTuple):
    """A piece of points that the host looks up where they are.

    Attributes
    ----------
    caster : Caster
        At the world that is seen.
    seen : SeenPoints
    piece : Piece
    """

    caster: Caster
    seen: SeenPoints
    piece: Piece

    def find(self, query: Query, found: FoundPoints) -> None:
        """Write the points of the primitives that a query finds."""
        surfaces, metrics = self._hold()
        arrays = metrics.records, surfaces.addresses, metrics.axes, metrics.half_lengths
        self._run(query, [*self._surplus(query), *arrays, *found])

    def find_inside(self) -> NDArray[np.bool_]:
        """Return (n,) bool: whether something contains each point of the chunk."""
        is_inside = np.empty(self.piece.end - self.piece.begin, np.bool_)
        self._run(_INSIDE, [*self._surplus(_INSIDE), is_inside])
        return is_inside

    def choose(self, count: int, slots: int, found: FoundPoints) -> NDArray[np.int32]:
        """Write the nearest primitives of the points, and return those whose slots are too few."""
        points, (surfaces, metrics) = self.piece.item_count, self._hold()
        check_room(points, slots * _SLOT_BYTES, "points")
        hits = np.empty(points * slots, self.caster.world.hit_dtype)
        candidates, is_crowded = np.empty(points * slots * _CANDIDATE_NUMBERS), np.empty(points, np.bool_)
        arrays = surfaces.addresses, metrics.axes, metrics.half_lengths
        self._run(
            _CLOSEST_POINTS, [metrics.records, hits, candidates, is_crowded, *arrays, *found], slots, count == 1, count
        )
        return self.piece.item_ids()[is_crowded] if is_crowded.any() else _NO_POINTS

    def find_hits(self, query: Query) -> NDArray[np.void]:
        """Return (n,) structs: what a kernel of the name finds for each point of the chunk."""
        hits = np.empty(self.piece.end - self.piece.begin, query.dtype)
        self._run(query, [hits])
        return hits

    def find_in_boxes(self, half_sides: NDArray[np.float32], slots: int) -> NDArray[np.void]:
        """Return (n, slots): what may meet the boxes around the piece's points, given half the sides of all boxes."""
        found = np.empty((self.piece.item_count, slots), self.caster.world.hit_dtype)
        self._run(_PRIMS_IN_BOXES, [self._hold()[1].records, half_sides[self.piece.begin :], found], slots)
        return found

    def find_room(self, slots: int) -> int:
        """Return for how many points there is room, if each has some slots."""
        return max(1, MOST_SLOTS // slots)

    def _hold(self) -> tuple[SurfaceArrays, Metrics]:
        """Return what a kernel is told of the world in float64, to be held until it returns.

        Addresses are no reference, and another thread may have made other arrays.
        """
        world = self.caster.world
        return world.arrays, world.metrics.metrics

    def _surplus(self, query: Query) -> tuple[Any, ...]:
        if query is CLOSEST_POINT:
            return ()
        surplus = self.caster.world.surplus
        return (None, None) if surplus is None else surplus

    def _run(self, query: Query, arrays: list[Any], *numbers: int) -> None:
        world, session = self.caster.world, self.caster.session
        points = _take_on_host(world, self.seen, self.piece)
        points.run(session, self.caster.kernel_at(world, query.kernel), arrays, *numbers)


def _take_on_host(world: World, seen: SeenPoints, piece: Piece) -> HostItems:
    """Return the points of a piece, which has some, as kernels of the host are told of them."""
    count, axes, bad = piece.item_count, begin_at(seen.axes, piece.begin), ALL_GOOD.copy()
    used = seen.points, seen.limits, seen.masks, axes, world.box_numbers, piece.order, bad
    points, limits, masks, axes_at, box, order_at, bad_at = find_addresses(used)
    is_double = seen.points.dtype.itemsize == 8
    numbers = points, 0, 0, limits, masks, is_double, axes_at, len(axes) - 2, count, box, order_at, bad_at
    groups = -(-count // _GROUP_POINTS), 1, _GROUP_POINTS
    return HostItems(numbers, groups, bad, used, partial(_explain, seen, piece, world.box))


def _explain(seen: SeenPoints, piece: Piece, box: TreeBox, bad: int) -> Exception:
    if piece.order is not None:
        # Others of the chunk may be bad as well.
        take_points(seen.rows, piece.begin, piece.end, box)
    return explain_bad_point(seen.rows, piece.begin + bad)


class DevicePoints(NamedTuple):
    """A piece of points that a device looks up; see `HostPoints`.

    Attributes
    ----------
    call : Call
        At the world that is seen.
    piece : Piece
        With an order.
    points : (n, 3) float, contiguous, the world's coordinates
        Of the chunk.
    masks : (n,) or (1,) uint32
    limits : (n,) or (1,) float64
    """

    call: Call
    piece: Piece
    points: NDArray[Any]
    masks: NDArray[np.uint32]
    limits: NDArray[np.float64]

    def find(self, query: Query, found: FoundPoints) -> None:
        """See `HostPoints`."""
        world, order = self.call.world, self.piece.item_ids()
        surplus = {} if query is CLOSEST_POINT else self._put_surplus()
        with self.call.cast(query, self._put(order), metrics=self._put_metrics(), **surplus) as prims:

            def refine(first: int, last: int) -> None:
                own = order[first:last], prims[first:last], found, order[first:last]
                refine_points(self.points, world.arrays, world.metrics.metrics, world.box, *own)

            self.call.threads.for_ranges(len(order), refine)

    def find_inside(self) -> NDArray[np.bool_]:
        """See `HostPoints`."""
        is_inside, box, order = np.zeros(len(self.points), np.bool_), self.call.world.box, self.piece.item_ids()
        is_in_box = np.abs((self.points - box.centre) * box.scale) <= box.half * _BOX_GROWTH
        order = order[np.logical_and.reduce(is_in_box, axis=1)[order]]
        if len(order):
            with self.call.cast(_INSIDE, self._put(order), **self._put_surplus()) as inside:
                is_inside[order] = inside
        return is_inside

    def choose(self, count: int, slots: int, found: FoundPoints) -> NDArray[np.int32]:
        """See `HostPoints`."""
        world, order = self.call.world, self.piece.item_ids()
        crowded = [_NO_POINTS]
        with self.call.cast(
            _CLOSEST_POINTS, self._put(order), results_per_item=slots, slots=np.int32(slots),
            is_single=np.int32(count == 1), metrics=self._put_metrics(),
        ) as hits:  # fmt: skip

            def choose(begin: int, end: int) -> None:
                own = hits[begin * slots : end * slots], order[begin:end], slots, count, found
                crowded.append(choose_points(self.points, world.arrays, world.metrics.metrics, world.box, *own))

            self.call.threads.for_ranges(len(order), choose)
        return np.concatenate(crowded)

    def find_in_boxes(self, half_sides: NDArray[np.float32], slots: int) -> NDArray[np.void]:
        """See `HostPoints`."""
        order = self.piece.item_ids()
        with self.call.cast(
            _PRIMS_IN_BOXES, self._put(order), results_per_item=slots, metrics=self._put_metrics(),
            half_sides=self.call.put("half_sides", half_sides[self.piece.begin + order]), slots=np.int32(slots),
        ) as found:  # fmt: skip
            return found.reshape(-1, slots).copy()

    def find_room(self, slots: int) -> int:
        """See `HostPoints`."""
        return max(1, self.call.fit(self.call.world.hit_dtype, MOST_SLOTS) // slots)

    def find_hits(self, query: Query) -> NDArray[np.void]:
        """See `HostPoints`."""
        order = self.piece.item_ids()
        with self.call.cast(query, self._put(order)) as found:
            hits = np.empty(len(order), found.dtype)
            hits[order] = found
        return hits

    def _put(self, order: NDArray[np.int32]) -> Batch:
        return pack.pack_points(self.call, self.points, self.masks, self.limits, order)

    def _put_metrics(self) -> Any:
        return self.call.world.metrics.put(self.call.caster.session, self.call.session)

    def _put_surplus(self) -> dict[str, Any]:
        """Return the arguments of cl/world/inside.cl that say which faces do not count."""
        surplus, names = self.call.world.surplus, ("surplus", "first_surplus")
        if surplus is None:
            return dict.fromkeys(names)
        return {name: self.call.put(name, array) for name, array in zip(names, surplus, strict=True)}


Points = HostPoints | DevicePoints


def look_up(
    caster: Caster, seen: SeenPoints, work: Callable[[Points], object], progress: Progress | None = None,
    most_points: int = 0,
) -> None:  # fmt: skip
    """Call a function with all points, piece by piece; see `run_pieces`.

    Parameters
    ----------
    caster : Caster
    seen : SeenPoints
    work : function
        Looks up a `HostPoints` or a `DevicePoints`.
    progress : function, optional
    most_points : int
        Of a piece; `CHUNK_RAYS` without it.
    """
    count, most = seen.count, min(most_points or pieces.CHUNK_RAYS, pieces.CHUNK_RAYS)

    def cut(call: Call) -> Iterator[Points]:
        here, own = _choose_world(call, seen)
        for begin, end in pack.cut_points_of(call, PACKED_POINT, count, progress, most_points=most):
            yield _take_piece(here, own, begin, end)

    are_few = count <= most and count < pack.LEAST_POINTS and seen.instance_ids is None
    are_few = are_few and caster.session.info.is_host
    all_points = HostPoints(caster, seen, Piece(0, count)) if are_few else None
    run_pieces(caster, count, all_points, cut, work, progress)


def _choose_world(call: Call, seen: SeenPoints) -> tuple[Call, SeenPoints]:
    """Return the call at the world of the instances that are visible at all, and the points there."""
    world, chosen = call.world, seen.instance_ids
    if chosen is None:
        return call, seen
    if world.is_lone:
        return call, SeenPoints(seen.points, seen.masks, limits=seen.limits) if 0 in chosen else seen.without_any()
    assert world.top is not None
    buffers = {name: call.session.upload(array) for name, array in prune_top(world.top, chosen).items()}
    return call.at(with_instances(world, buffers)), seen


def _take_piece(call: Call, seen: SeenPoints, begin: int, end: int) -> Points:
    """Return a piece of points, in an order in which neighbours are close; few of them stay in their own."""
    world, is_host = call.world, call.session.info.is_host
    if is_host and end - begin < pack.LEAST_POINTS:
        return HostPoints(call.caster.at(world), seen, Piece(begin, end))
    points = take_points(seen.rows, begin, end, world.box)
    order = pack.find_point_order(points, world.box, call.order_by_keys)
    piece = Piece(begin, end, order)
    if is_host:
        return HostPoints(call.caster.at(world), seen, piece)
    masks, limits = (rows.part(begin, end, rows.items.dtype) for rows in (seen.mask_rows, seen.limit_rows))
    return DevicePoints(call, piece, points, masks, limits)

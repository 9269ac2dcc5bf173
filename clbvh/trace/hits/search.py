"""Rays are cast piece by piece: on the host where they are, on other devices packed.

A query is a function that is called with each piece, a `HostRays` or a `DeviceRays`. Both have the same methods, whose
answers have the same bits. Points are looked up in the same way, see `points/search.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..host_items import HostItems
from ..launch import Call, Caster, Query, run_pieces
from ..put_rays import cut_batch, put_rays
from ..rays import pieces
from ..rays.batch import RayBatch
from ..rays.pieces import Piece, Progress
from .refine import LEAST_HITS, RefinedHits, refine_closest

# The host's kernel takes the surfaces and the arrays of refined hits as well, see cl/on_host/kernels/closest_hit.cl.
CLOSEST_HIT = Query("closest_hit", "hits", more_here=1 + len(RefinedHits._fields))
FIRST_HITS = Query("first_hits", "hits")

# Slots on the device at a time: 32 MiB. A single ray with more gets the room it needs.
MOST_SLOTS = 2**21


class HostRays(NamedTuple):
    """A piece of rays that the host casts where they are.

    Attributes
    ----------
    caster : Caster
    call : Call or None
        Lends memory to many rays; few need none.
    batch : RayBatch
    piece : Piece
    """

    caster: Caster
    call: Call | None
    batch: RayBatch
    piece: Piece

    def answer(self, query: Query, answers: NDArray[Any], **numbers: Any) -> None:
        """Write what a kernel finds for each ray of the chunk, of hits the primitive, given its further arguments."""
        own = answers[self.piece.begin : self.piece.end]
        # Of closest hits, what `closest_hit` writes but for the primitives is left out.
        self._run(query, [*[None] * 6, own, None] if query is CLOSEST_HIT else [own], *numbers.values())

    def refine(self, hits: RefinedHits) -> None:
        """Write the closest hits of the batch's rays in float64."""
        if self.piece.order is not None:
            # Written one by one, hits of sorted rays would go all over memory.
            assert self.call is not None
            DeviceRays(self.call, self.batch, self.piece).refine(hits)
            return
        # Held until the kernel returns: their addresses are no reference, and another thread may have made others.
        surfaces = self.caster.world.arrays
        *written, instance_id = hits.part(self.piece.begin, self.piece.end)
        arrays = None, surfaces.addresses, *written, None if surfaces.is_lone else instance_id
        self._run(CLOSEST_HIT, arrays)

    def find(self, query: Query, slots: int = 1) -> AbstractContextManager[NDArray[Any]]:
        """Give the results of a kernel, `slots` of each ray: of the first hits in the order of the piece."""
        if self.call is not None:
            return DeviceRays(self.call, self.batch, self.piece).find(query, slots)
        found = np.empty(self.piece.item_count * slots, query.dtype or self.caster.world.hit_dtype)
        self._run(query, [found, *[None] * query.more_here], *([slots] if query is FIRST_HITS else []))
        return nullcontext(found)

    def find_room(self, slots: int) -> int:
        """Return for how many rays there is room, if each has some slots."""
        return max(1, MOST_SLOTS // slots) if self.call is None else _find_room(self.call, slots)

    def _run(self, query: Query, arrays: Any, *numbers: int) -> None:
        caster, world = self.caster, self.caster.world
        rays = HostItems.of_rays(
            caster.session.settings, world, self.batch, self.piece, in_ray_order=query is not FIRST_HITS
        )
        rays.run(caster.session, caster.kernel_at(world, query.kernel), arrays, *numbers)


class DeviceRays(NamedTuple):
    """A piece of rays whose results come by a buffer of the call; see `HostRays`."""

    call: Call
    batch: RayBatch
    piece: Piece

    @property
    def caster(self) -> Caster:
        """See `HostRays`."""
        return self.call.caster

    def answer(self, query: Query, answers: NDArray[Any], **numbers: Any) -> None:
        """See `HostRays`."""
        with self.call.cast(query, put_rays(self.call, self.batch, self.piece), **numbers) as found:
            own = found["prim_id"] if query.dtype is None else found
            answers[self.piece.begin : self.piece.begin + len(found)] = own

    def refine(self, hits: RefinedHits) -> None:
        """See `HostRays`."""
        begin, arrays = self.piece.begin, self.call.world.arrays
        with self.find(CLOSEST_HIT) as found:

            def refine(first: int, last: int) -> None:
                refine_closest(
                    self.batch, begin + first, arrays, found[first:last], hits.part(begin + first, begin + last)
                )

            self.call.threads.for_ranges(len(found), refine, least_items=LEAST_HITS)

    def find(self, query: Query, slots: int = 1) -> AbstractContextManager[NDArray[Any]]:
        """See `HostRays`."""
        is_first = query is FIRST_HITS
        rays = put_rays(self.call, self.batch, self.piece, in_ray_order=not is_first)
        numbers = {"slots": np.int32(slots)} if is_first else {}
        return self.call.cast(query, rays, results_per_item=slots, **numbers)

    def find_room(self, slots: int) -> int:
        """See `HostRays`."""
        return _find_room(self.call, slots)


Rays = HostRays | DeviceRays


def _find_room(call: Call, slots: int) -> int:
    return max(1, call.fit(call.world.hit_dtype, MOST_SLOTS) // slots)


def cast_rays(
    caster: Caster, batch: RayBatch, work: Callable[[Rays], object], progress: Progress | None = None, slots: int = 0
) -> None:
    """Call a function with all rays of a batch, piece by piece; see `run_pieces`.

    Parameters
    ----------
    caster : Caster
    batch : RayBatch
    work : function
        Casts a `HostRays` or a `DeviceRays`.
    progress : function, optional
    slots : int
        Results of each ray, if the pieces are to have room for them.
    """

    def cut(call: Call) -> Iterator[Rays]:
        most_rays = _find_room(call, slots) if slots else 0
        for piece in cut_batch(call, batch, most_rays=most_rays, progress=progress):
            is_host = call.session.info.is_host
            yield HostRays(call.caster, call, batch, piece) if is_host else DeviceRays(call, batch, piece)

    are_few = batch.ray_count < pieces.LEAST_RAYS and caster.session.info.is_host
    all_rays = HostRays(caster, None, batch, Piece(0, batch.ray_count)) if are_few else None
    run_pieces(caster, batch.ray_count, all_rays, cut, work, progress)

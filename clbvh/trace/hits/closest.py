"""Queries with one answer for each ray: the closest hit, any hit, the number of hits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import STEPS
from ..host_items import HostItems
from ..launch import Call, Caster, Query
from ..put_rays import COUNT_STEPS, cut_batch, put_rays
from ..rays import pieces
from ..rays.batch import RayBatch, check_room, read_rays
from ..rays.pieces import Progress, RayPiece
from .hits import Hits
from .refine import LEAST_HITS, RefinedHits, refine_closest
from .surface import Surface

# The host's kernel takes the surfaces and the arrays of refined hits as well, see cl/on_host/kernels/closest_hit.cl.
CLOSEST_HIT = Query("closest_hit", "hits", more_here=1 + len(RefinedHits._fields))
ANY_HIT = Query("any_hit", "blocked", np.dtype(np.uint8))
COUNT_HITS = Query("count_hits", "counts", np.dtype(np.int32))

# "All of them", for a kernel that stops at a number of hits.
NO_LIMIT = np.iinfo(np.int32).max

# t, u, v, prim_id, is_front and, with instances, instance_id of a ray.
HIT_BYTES = 33


def find_closest_hits(caster: Caster, batch: RayBatch, progress: Progress | None) -> Hits:
    """Return the closest hit of each ray in float64; see `Tracer.closest_hit`."""
    world = caster.world
    check_room(batch.ray_count, HIT_BYTES)
    refined = RefinedHits.make(batch.shape, is_lone=world.is_lone)
    flat = refined if are_few(caster, batch) else refined.reshape(-1)

    def cast_here(device: Caster, piece: RayPiece) -> None:
        # Held until the kernel returns: their addresses are no reference, and another thread may have made others.
        surfaces = device.world.arrays
        *written, instance_id = flat.part(piece.begin, piece.end)
        cast_on_host(
            device, CLOSEST_HIT, batch, piece,
            (None, surfaces.addresses, *written, None if world.is_lone else instance_id),
        )  # fmt: skip

    def cast_on_device(call: Call, piece: RayPiece) -> None:
        with call.cast(CLOSEST_HIT, put_rays(call, batch, piece)) as found:
            arrays = call.world.arrays

            def refine(first: int, last: int) -> None:
                part = flat.part(piece.begin + first, piece.begin + last)
                refine_closest(batch, piece.begin + first, arrays, found[first:last], part)

            call.threads.for_ranges(len(found), refine, least_items=LEAST_HITS)

    # The hits of sorted rays are refined in the order of the rays: they would be written all over memory.
    _cast_batch(caster, batch, cast_here, cast_on_device, progress, casts_sorted=False)
    return refined.as_hits(Surface.of_world(world))


def are_few(caster: Caster, batch: RayBatch) -> bool:
    """Return whether rays are cast as they are, neither cut nor sorted, and on the host."""
    return batch.ray_count < pieces.LEAST_RAYS and caster.session.info.is_host


def cast_on_host(
    device: Caster, query: Query, batch: RayBatch, piece: RayPiece, arrays: Iterable[NDArray[Any] | None], *numbers: int
) -> None:
    """Cast a piece on the host; see `HostItems.run`."""
    rays = HostItems.of_rays(device.session.settings, device.world, batch, piece)
    rays.run(device.session, device.kernel_at(device.world, query.kernel), arrays, *numbers)


def _cast_batch(
    caster: Caster, batch: RayBatch, cast_here: Callable[[Caster, RayPiece], None],
    cast_on_device: Callable[[Call, RayPiece], None], progress: Progress | None, *, casts_sorted: bool = True,
) -> None:  # fmt: skip
    """Cast a batch piece by piece; of few rays on the host in one piece, without a call.

    With `casts_sorted` false, sorted pieces take the device's way on the host, too.
    """

    def cast(call: Call) -> None:
        for piece in cut_batch(call, batch, progress=progress):
            if call.session.info.is_host and (casts_sorted or piece.order is None):
                cast_here(call.caster, piece)
            else:
                cast_on_device(call, piece)

    count = batch.ray_count
    if not are_few(caster, batch):
        caster.run(cast)
        return
    if count == 0:
        caster.calls.check_open()
        return
    caster.run_without_call(partial(cast_here, caster, RayPiece(0, count)))
    if progress is not None:
        progress(count, count)


def find_closest_prims(caster: Caster, batch: RayBatch, progress: Progress | None) -> NDArray[np.int32]:
    """Return the face of the closest hit of each ray; see `Tracer.closest_prim`."""
    return _answer(caster, CLOSEST_HIT, np.int32, batch, progress)


def find_any_hits(caster: Caster, batch: RayBatch, progress: Progress | None) -> NDArray[np.bool_]:
    """Return whether each ray hits anything; see `Tracer.any_hit`."""
    return _answer(caster, ANY_HIT, np.bool_, batch, progress)


def count_hits(caster: Caster, batch: RayBatch, max_hits: int | None, progress: Progress | None) -> NDArray[np.int32]:
    """Return the number of hits of each ray, `max_hits` at most; see `Tracer.count_hits`."""
    return _answer(caster, COUNT_HITS, np.int32, batch, progress, max_hits=np.int32(max_hits or NO_LIMIT))


def count_steps(caster: Caster, origins: ArrayLike, directions: ArrayLike) -> NDArray[np.void]:
    """Return (...,) `structs.STEPS`: the steps of each ray on its way to its closest hit, from the root of the tree.

    A node step tests the boxes of all children of one node, of the tree over the instances or of a shape's. A visit of
    a leaf is one block of primitives in wide layouts.
    """
    batch = read_rays(origins, directions, 0.0, np.inf)
    return _answer(caster, COUNT_STEPS, STEPS, batch, None)


def _answer(
    caster: Caster, query: Query, dtype: Any, batch: RayBatch, progress: Progress | None, **numbers: Any
) -> NDArray[Any]:
    """Return what a kernel finds for each ray; of hits, the primitive."""
    count = batch.ray_count
    check_room(count, np.dtype(dtype).itemsize)
    answers = np.empty(count, dtype)

    def cast_here(device: Caster, piece: RayPiece) -> None:
        own = answers[piece.begin : piece.end]
        # Of closest hits, what `closest_hit` writes but for the primitives is left out.
        arrays = [*[None] * 6, own, None] if query is CLOSEST_HIT else [own]
        cast_on_host(device, query, batch, piece, arrays, *numbers.values())

    def cast_on_device(call: Call, piece: RayPiece) -> None:
        with call.cast(query, put_rays(call, batch, piece), **numbers) as found:
            own = found["prim_id"] if query.dtype is None else found
            answers[piece.begin : piece.begin + len(found)] = own

    _cast_batch(caster, batch, cast_here, cast_on_device, progress)
    return answers.reshape(batch.shape)

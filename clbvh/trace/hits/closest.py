"""Queries with one answer for each ray: the closest hit, any hit, the number of hits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import PACKED_RAY_LANES, WORLD_HIT
from ...support.compiled import compiled
from ..host.walk import FIELD_COUNT, walk
from ..launch import ANY_HIT, CLOSEST_HIT, COUNT_HITS, NO_LIMIT, Call, Caster, Query, cut_smaller_when_full
from ..rays.batch import RayBatch, TreeBox, check_room
from ..rays.pack import ALL_GOOD, NO_LOWS, explain_bad_ray, write_packed
from ..rays.pieces import Progress
from ..traced_tree import WideArrays
from .hits import Hits
from .refine import RefinedHits, refine_closest, refine_found
from .refine_block import RefineBlock

Shape = tuple[int, ...]

# t, u, v, prim_id, is_front and, in a scene, instance_id of a ray.
_HIT_BYTES = 33


@cut_smaller_when_full
def find_closest_hits(caster: Caster, batch: RayBatch, shape: Shape, progress: Progress | None) -> Hits:
    """Return the closest hit of each ray in float64; see `Tracer.closest_hit`."""
    count = batch.ray_count
    check_room(count, _HIT_BYTES)
    tree, surface = caster.tree, caster.tree.surface
    refined = RefinedHits.make(count, has_instances=tree.hit_dtype == WORLD_HIT)
    with caster.open_call() as call:
        if (host_tree := call.on_host(count)) is not None:
            call.run_on_host(_find_closest_on_host, host_tree, call.box, batch, surface, refined)
            if progress is not None:
                progress(count, count)
        else:
            for begin, found in _cast_pieces(call, CLOSEST_HIT, batch, shape, progress):

                def refine(first: int, last: int, begin: int = begin, found: NDArray[np.void] = found) -> None:
                    rays = begin + first, begin + last
                    refine_closest(batch.part(*rays), surface, found[first:last], refined.part(*rays))

                caster.threads.for_ranges(len(found), refine)
    return refined.as_hits(shape, mesh=tree.mesh, surface=tree.scene_surface)


@cut_smaller_when_full
def find_closest_prims(caster: Caster, batch: RayBatch, shape: Shape, progress: Progress | None) -> NDArray[np.int32]:
    """Return the face of the closest hit of each ray; see `Tracer.closest_prim`."""
    check_room(batch.ray_count, 4)
    prim_id = np.empty(batch.ray_count, np.int32)
    for begin, found in _cast_rays(caster, CLOSEST_HIT, batch, shape, progress):

        def copy(first: int, last: int, begin: int = begin, prims: NDArray[np.int32] = found["prim_id"]) -> None:
            prim_id[begin + first : begin + last] = prims[first:last]

        caster.threads.for_ranges(len(found), copy)
    return prim_id.reshape(shape)


@cut_smaller_when_full
def find_any_hits(caster: Caster, batch: RayBatch, shape: Shape, progress: Progress | None) -> NDArray[np.bool_]:
    """Return whether each ray hits anything; see `Tracer.any_hit`."""
    check_room(batch.ray_count, 1)
    is_blocked = np.empty(batch.ray_count, np.bool_)
    for begin, found in _cast_rays(caster, ANY_HIT, batch, shape, progress):
        is_blocked[begin : begin + len(found)] = found
    return is_blocked.reshape(shape)


@cut_smaller_when_full
def count_hits(
    caster: Caster, batch: RayBatch, shape: Shape, max_hits: int | None, progress: Progress | None
) -> NDArray[np.int32]:
    """Return the number of hits of each ray, `max_hits` at most; see `Tracer.count_hits`."""
    check_room(batch.ray_count, 4)
    counts = np.empty(batch.ray_count, np.int32)
    most = np.int32(max_hits or NO_LIMIT)
    for begin, found in _cast_rays(caster, COUNT_HITS, batch, shape, progress, max_hits=most):
        counts[begin : begin + len(found)] = found
    return counts.reshape(shape)


def _cast_rays(
    caster: Caster, query: Query, batch: RayBatch, shape: Shape, progress: Progress | None, **arguments: Any
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the results of each piece of a batch, in the order of the rays, and the index of its first ray.

    Results are valid until the next ones are asked for.
    """
    with caster.open_call() as call:
        if (tree := call.on_host(batch.ray_count)) is not None:
            yield 0, call.cast_on_host(tree, query, batch, **arguments)
            if progress is not None:
                progress(batch.ray_count, batch.ray_count)
        else:
            yield from _cast_pieces(call, query, batch, shape, progress, **arguments)


def _cast_pieces(
    call: Call, query: Query, batch: RayBatch, shape: Shape, progress: Progress | None, **arguments: Any
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield what the device finds, as `_cast_rays`."""
    for piece in call.cut_rays(batch, shape, progress=progress):
        with call.cast(query, call.pack_rays(batch, piece), **arguments) as found:
            yield piece.begin, found


def _find_closest_on_host(tree: WideArrays, box: TreeBox, batch: RayBatch, surface: Any, hits: RefinedHits) -> None:
    """Write the closest hits of few rays, to the last bit as `refine_closest` does of the device's.

    In one compiled call: each call of a compiled function from Python costs microseconds, as long as tens of rays.
    """
    count = batch.ray_count
    packed, found = np.empty((count, PACKED_RAY_LANES), np.float32), np.empty((count, FIELD_COUNT), np.int32)
    bad = _find_closest(batch.part(0, count), box, tree, surface, packed, found, NO_LOWS, RefineBlock.make(), hits)
    if bad != ALL_GOOD:
        raise explain_bad_ray(batch, bad)


@compiled
def _find_closest(rays, box, tree, surface, packed, found, no_lows, block, hits):
    """Pack rays, traverse the tree with them and refine their hits; return as `write_packed`."""
    bad = write_packed(rays, box, None, packed, no_lows, no_lows)
    if bad == ALL_GOOD:
        walk(tree, packed, 0, found)
        refine_found(rays, surface, found, block, hits)
    return bad

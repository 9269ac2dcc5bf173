"""Queries with one answer for each ray: the closest hit, any hit, the number of hits."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import STEPS
from ..launch import Call, Caster, Query
from ..put_rays import COUNT_STEPS, cut_batch, put_rays
from ..ranges import cast_rays
from ..rays.batch import RayBatch, Rays, check_room, read_rays
from ..rays.pieces import Progress
from ..world.surface_arrays import SurfaceArrays
from .hits import Hits
from .refine import LEAST_HITS, RefinedHits, refine_closest
from .surface import Surface

Shape = tuple[int, ...]

CLOSEST_HIT = Query("closest_hit", "hits")
ANY_HIT = Query("any_hit", "blocked", np.dtype(np.uint8))
COUNT_HITS = Query("count_hits", "counts", np.dtype(np.int32))

# "All of them", for a kernel that stops at a number of hits.
NO_LIMIT = np.iinfo(np.int32).max

# t, u, v, prim_id, is_front and, with instances, instance_id of a ray.
HIT_BYTES = 33


def find_closest_hits(caster: Caster, batch: RayBatch, shape: Shape, progress: Progress | None) -> Hits:
    """Return the closest hit of each ray in float64; see `Tracer.closest_hit`."""
    count, world = batch.ray_count, caster.world
    check_room(count, HIT_BYTES)
    refined = RefinedHits.make(count, is_lone=world.is_lone)

    def cast(call: Call, part: range, progress: Progress | None) -> None:
        for piece in cut_batch(call, batch, shape, part=part, progress=progress):
            with call.cast(CLOSEST_HIT, put_rays(call, batch, piece)) as found:
                refine = partial(_refine_range, batch, piece.begin, call.world.arrays, found, refined)
                call.threads.for_ranges(len(found), refine, least_items=LEAST_HITS)

    cast_rays(caster, batch, shape, cast, progress)
    return refined.as_hits(shape, Surface.of_world(world))


def _refine_range(
    batch: RayBatch,
    begin: int,
    arrays: SurfaceArrays,
    found: NDArray[np.void],
    hits: RefinedHits,
    first: int,
    last: int,
) -> None:
    rays = begin + first, begin + last
    refine_closest(batch.part(*rays), arrays, found[first:last], hits.part(*rays))


def find_closest_prims(caster: Caster, batch: Rays, shape: Shape, progress: Progress | None) -> NDArray[np.int32]:
    """Return the face of the closest hit of each ray; see `Tracer.closest_prim`."""
    return _answer(caster, CLOSEST_HIT, np.int32, batch, shape, progress)


def find_any_hits(caster: Caster, batch: Rays, shape: Shape, progress: Progress | None) -> NDArray[np.bool_]:
    """Return whether each ray hits anything; see `Tracer.any_hit`."""
    return _answer(caster, ANY_HIT, np.bool_, batch, shape, progress)


def count_hits(
    caster: Caster, batch: Rays, shape: Shape, max_hits: int | None, progress: Progress | None
) -> NDArray[np.int32]:
    """Return the number of hits of each ray, `max_hits` at most; see `Tracer.count_hits`."""
    return _answer(caster, COUNT_HITS, np.int32, batch, shape, progress, max_hits=np.int32(max_hits or NO_LIMIT))


def count_steps(caster: Caster, origins: ArrayLike, directions: ArrayLike) -> NDArray[np.void]:
    """Return (...,) `structs.STEPS`: the steps of each ray on its way to its closest hit, from the root of the tree.

    A node step tests the boxes of all children of one node, of the tree over the instances or of a shape's. A visit of
    a leaf is one block of primitives in wide layouts.
    """
    batch, shape = read_rays(origins, directions, 0.0, np.inf)
    return _answer(caster, COUNT_STEPS, STEPS, batch, shape, None)


def _answer(
    caster: Caster, query: Query, dtype: Any, batch: Rays, shape: Shape, progress: Progress | None, **arguments: Any
) -> NDArray[Any]:
    """Return what a kernel finds for each ray; of hits, the primitive."""
    count = batch.ray_count
    check_room(count, np.dtype(dtype).itemsize)
    answers = np.empty(count, dtype)

    def cast(call: Call, part: range, progress: Progress | None) -> None:
        for piece in cut_batch(call, batch, shape, part=part, progress=progress):
            with call.cast(query, put_rays(call, batch, piece), **arguments) as found:
                own = found["prim_id"] if query.dtype is None else found
                answers[piece.begin : piece.begin + len(found)] = own

    cast_rays(caster, batch, shape, cast, progress)
    return answers.reshape(shape)

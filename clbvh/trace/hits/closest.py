"""Queries with one answer for each ray: the closest hit, any hit, the number of hits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import STEPS
from ..launch import Caster, Query
from ..put_rays import COUNT_STEPS
from ..rays.batch import RayBatch, check_room, read_rays
from ..rays.pieces import Progress
from .hits import Hits
from .refine import RefinedHits
from .search import CLOSEST_HIT, cast_rays
from .surface import Surface

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
    cast_rays(caster, batch, lambda rays: rays.refine(refined), progress)
    return refined.as_hits(Surface.of_world(world))


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
    check_room(batch.ray_count, np.dtype(dtype).itemsize)
    answers = np.empty(batch.ray_count, dtype)
    cast_rays(caster, batch, lambda rays: rays.answer(query, answers, **numbers), progress)
    return answers.reshape(batch.shape)

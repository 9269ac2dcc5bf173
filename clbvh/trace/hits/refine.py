"""Hits from the device are computed again in float64, on the file's own vertices.

Of what the device found only the primitive counts. So t, u and v depend on nothing but the ray and the primitive, and
not on the layout, the device, or its compiler. Hits are refined in blocks, see `refine_block.py`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import HIT_PRIM_ID, NO_PRIM, SCENE_HIT_INSTANCE_ID
from ...support.compiled import compiled
from ...support.prefetch import prefetch
from ..rays.batch import RayBatch
from ..rays.ray_rows import RayRows
from ..triangles import Triangles
from .crossings import Crossings, source_index
from .hits import Hits
from .refine_block import BLOCK_HITS, PREFETCH_HITS, TUV, RefineBlock
from .refine_surface import locate, refine_block
from .scene_arrays import SceneArrays
from .surface import SceneSurface

# Rays that are made contiguous at a time, where they are not.
_MOST_RAYS = 2**20

# The t of a hit beyond float64: infinity is the t of a miss.
_MOST_T = np.finfo(np.float64).max


class HitIds(NamedTuple):
    """Where the ids of hits go, one element for each hit.

    Attributes
    ----------
    prim_id : (n,) int32 or int64
    instance_id : (n,) int32 or None
        Only in scenes.
    """

    prim_id: NDArray[Any]
    instance_id: NDArray[np.int32] | None

    @classmethod
    def make(cls, count: int, *, has_instances: bool = False, dtype: type[np.integer] = np.int32) -> HitIds:
        """Return arrays for the ids of hits, not yet written."""
        return cls(np.empty(count, dtype), np.empty(count, np.int32) if has_instances else None)

    def part(self, begin: int, end: int) -> HitIds:
        """Return views for some of the hits."""
        part = slice(begin, end)
        return HitIds(self.prim_id[part], None if self.instance_id is None else self.instance_id[part])


class RefinedHits(NamedTuple):
    """Where refined hits go, one element for each hit; see `Hits`."""

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    is_front: NDArray[np.bool_]

    @classmethod
    def make(cls, count: int) -> RefinedHits:
        """Return arrays for hits, not yet written."""
        return cls(np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.bool_))

    def part(self, begin: int, end: int) -> RefinedHits:
        """Return views for some of the hits."""
        part = slice(begin, end)
        return RefinedHits(self.t[part], self.u[part], self.v[part], self.is_front[part])

    def as_hits(
        self, ids: HitIds, shape: tuple[int, ...], *, mesh: Mesh | None, scene_surface: SceneSurface | None = None
    ) -> Hits:
        """Return the hits of rays of a leading shape, on a mesh or in a scene."""
        t, u, v = (values.reshape(shape) for values in (self.t, self.u, self.v))
        return Hits(
            t, u, v, ids.prim_id.reshape(shape), mesh,
            is_front=self.is_front.reshape(shape), scene_surface=scene_surface,
            known_instance_id=None if ids.instance_id is None else ids.instance_id.reshape(shape),
        )  # fmt: skip


def refine_closest(
    rays: RayRows, surface: Triangles | SceneArrays, found: NDArray[np.void], hits: RefinedHits, ids: HitIds
) -> None:
    """Write one hit for each ray in float64.

    Parameters
    ----------
    rays : RayRows
        The rays that were cast, as the user gave them.
    surface : Triangles or SceneArrays
    found : (n,) `structs.HIT` or `structs.SCENE_HIT`
        What the device found.
    hits : RefinedHits of (n,) arrays, written
        Where float64 sees the ray pass beside the primitive, by less than float32 resolves, t, u and v are those of the
        primitive's point that is nearest to the ray.
    ids : HitIds of (n,) arrays, written
    """
    lanes = np.ascontiguousarray(found).view(np.float32).reshape(-1, found.dtype.itemsize // 4)
    refine_found(rays, surface, lanes.view(np.int32), RefineBlock.make(), hits, ids.prim_id, ids.instance_id)


def refine_crossings(
    batch: RayBatch,
    surface: Triangles | SceneArrays,
    crossings: Crossings,
    begin: int,
    end: int,
    next_slots: NDArray[np.int64],
    *,
    ids: HitIds,
    hits: RefinedHits | None = None,
    ray_id: NDArray[np.int64] | None = None,
    locations: NDArray[np.float64] | None = None,
) -> None:
    """Write several hits for each ray in float64.

    Parameters
    ----------
    batch : RayBatch
        All rays.
    surface : Triangles or SceneArrays
    crossings : Crossings
        Of all rays.
    begin, end : int
        The rays to work on.
    next_slots : (1,) or (depths,) int64, changed
        Index of the first hit in the results: ray after ray; or, with a `ray_id`, one for each depth.
    ids : HitIds of (m,) arrays, written
    hits : RefinedHits of (m,) arrays, written
        With one mesh, no t is smaller than that of the crossing before it on the ray. The device's order holds for all
        queries, so that `all_hits` begins with what `closest_hit` finds; float64 may see two crossings that are closer
        than float32 resolves in the other order. In a scene, the hits of a ray are in the order of t in float64: the
        device resolves the distance of two instances less the farther they are from the ray's origin.
    ray_id : (m,) int64, written
    locations : (m, 3) float64, written
    """
    first_slot = int(next_slots[0]) if len(next_slots) else 0
    found_ints, block = crossings.found.view(np.int32), RefineBlock.make()
    for first in range(begin, end, _MOST_RAYS):
        last = min(first + _MOST_RAYS, end)
        # Counts and sources of these rays alone: their indices agree with the part's.
        of_part = crossings._replace(counts=crossings.counts[first:last], sources=crossings.sources[first:last])
        _refine_crossings(
            batch.part(first, last), surface, of_part, found_ints, block, first, next_slots,
            ids.prim_id, ids.instance_id, hits, ray_id, locations,
        )  # fmt: skip
    if hits is None:
        return
    counts = crossings.counts[begin:end]
    if ids.instance_id is None:
        _keep_order(counts, first_slot, hits.t)
    else:
        _sort_by_t(counts, first_slot, hits, ids.prim_id, ids.instance_id, locations)


@compiled(error_model="numpy")
def refine_found(rays, surface, found_ints, block, hits, prim_id, instance_id):
    """Write one hit for each ray, as `refine_closest`; `found_ints` are (n, lanes) int32."""
    t, u, v, is_front = hits.t, hits.u, hits.v, hits.is_front
    count = 0
    for ray in range(len(found_ints)):
        prim = found_ints[ray, HIT_PRIM_ID]
        prim_id[ray] = prim
        if instance_id is not None:
            instance_id[ray] = found_ints[ray, SCENE_HIT_INSTANCE_ID] if prim != NO_PRIM else NO_PRIM
        if prim == NO_PRIM:
            t[ray], u[ray], v[ray], is_front[ray] = np.inf, 0.0, 0.0, False
        else:
            block.rays[count] = block.sources[count] = block.targets[count] = ray
            count += 1
        if count == BLOCK_HITS or ray == len(found_ints) - 1:
            refine_block(rays, surface, found_ints, block, count)
            _store_hits(rays.t_min, rays.t_max, block, count, hits)
            count = 0


@compiled(error_model="numpy")
def _refine_crossings(
    rays, surface, crossings, found_ints, block, first_ray, next_slots, prim_id, instance_id, hits, ray_id, locations
):
    counts, sources, segment_begins = crossings.counts, crossings.sources, crossings.segment_begins
    found = crossings.found
    ray, depth = 0, 0
    while ray < len(counts):
        # List the next hits, and where they go.
        count = 0
        while ray < len(counts) and count < BLOCK_HITS:
            if depth == counts[ray]:
                ray, depth = ray + 1, 0
                if ray + PREFETCH_HITS < len(counts):
                    coming = source_index(sources[ray + PREFETCH_HITS], segment_begins)
                    prefetch(found, found.shape[1] * coming + HIT_PRIM_ID)
                continue
            counter = 0 if ray_id is None else depth
            block.rays[count], block.targets[count] = ray, next_slots[counter]
            block.sources[count] = source_index(sources[ray], segment_begins) + depth
            next_slots[counter] += 1
            depth += 1
            count += 1
        for hit in range(count):
            prim_id[block.targets[hit]] = found_ints[block.sources[hit], HIT_PRIM_ID]
        if instance_id is not None:
            for hit in range(count):
                instance_id[block.targets[hit]] = found_ints[block.sources[hit], SCENE_HIT_INSTANCE_ID]
        if ray_id is not None:
            for hit in range(count):
                ray_id[block.targets[hit]] = first_ray + block.rays[hit]

        # Refine what is wanted of them.
        if hits is not None or locations is not None:
            refine_block(rays, surface, found_ints, block, count)
        if hits is not None:
            _store_hits(rays.t_min, rays.t_max, block, count, hits)
        if locations is not None:
            locate(surface, found_ints, block, count, locations)


@compiled
def _keep_order(counts, first_slot, t):
    """Raise each t to that of the crossing before it on the ray."""
    slot = first_slot
    for ray in range(len(counts)):
        for depth in range(counts[ray]):
            if depth > 0:
                t[slot] = max(t[slot], t[slot - 1])
            slot += 1


@compiled
def _sort_by_t(counts, first_slot, hits, prim_id, instance_id, locations):
    """Sort the hits of each ray by t; equal ones keep their order. Nearly all are in order already."""
    t = hits.t
    begin = first_slot
    for ray in range(len(counts)):
        end = begin + counts[ray]
        for slot in range(begin + 1, end):
            while slot > begin and t[slot] < t[slot - 1]:
                _swap(slot, hits, prim_id, instance_id, locations)
                slot -= 1
        begin = end


@compiled
def _swap(slot, hits, prim_id, instance_id, locations):
    """Swap a hit with the one before it."""
    t, u, v, is_front = hits.t, hits.u, hits.v, hits.is_front
    t[slot], t[slot - 1] = t[slot - 1], t[slot]
    u[slot], u[slot - 1] = u[slot - 1], u[slot]
    v[slot], v[slot - 1] = v[slot - 1], v[slot]
    is_front[slot], is_front[slot - 1] = is_front[slot - 1], is_front[slot]
    prim_id[slot], prim_id[slot - 1] = prim_id[slot - 1], prim_id[slot]
    instance_id[slot], instance_id[slot - 1] = instance_id[slot - 1], instance_id[slot]
    if locations is not None:
        for axis in range(3):
            locations[slot, axis], locations[slot - 1, axis] = locations[slot - 1, axis], locations[slot, axis]


@compiled
def _store_hits(t_mins, t_maxs, block, count, hits):
    """Write t, within the ray's limits, u, v and side of a block's hits to their targets."""
    tuv, volumes = block.vectors[TUV], block.volumes
    t, u, v, is_front, targets = hits.t, hits.u, hits.v, hits.is_front, block.targets
    for hit in range(count):
        ray, target = block.rays[hit], targets[hit]
        t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
        t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
        t[target] = min(max(tuv[0, hit], t_min), t_max, _MOST_T)
        u[target], v[target], is_front[target] = tuv[1, hit], tuv[2, hit], volumes[hit] > 0.0

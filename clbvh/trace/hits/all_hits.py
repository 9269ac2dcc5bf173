"""All hits in their final order, refined on the way there: ray by ray, or depth by depth."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ...structs import SCENE_HIT
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..launch import Caster
from ..rays.batch import RayBatch
from ..rays.pieces import Progress
from .crossings import find_crossings, running_sums
from .hits import AllHits
from .refine import HitIds, RefinedHits, refine_crossings

# Two cache lines, in counters of 8 bytes. Counters of several threads in one cache line cost all that threads gain.
_PADDING = 16


def find_all_hits(
    caster: Caster,
    batch: RayBatch,
    shape: tuple[int, ...],
    max_hits: int | None,
    progress: Progress | None,
    *,
    with_locations: bool = False,
) -> AllHits:
    """Return the crossings of each ray in the order along it; see `Tracer.all_hits`."""
    crossings = find_crossings(caster, batch, shape, max_hits, progress)
    offsets = running_sums(crossings.counts)
    total = int(offsets[-1])
    tree, surface = caster.tree, caster.tree.surface
    refined, ids = RefinedHits.make(total), HitIds.make(total, has_instances=tree.hit_dtype == SCENE_HIT)
    locations = np.empty((total, 3)) if with_locations else None
    ranges = _cut_evenly(caster.threads, offsets)
    next_slots = _make_counters(len(ranges), 1)
    next_slots[:, 0] = [offsets[begin] for begin, _ in ranges]

    def refine(begin: int, end: int, next_slot: NDArray[np.int64]) -> None:
        refine_crossings(batch, surface, crossings, begin, end, next_slot, ids=ids, hits=refined, locations=locations)

    caster.threads.run(refine, [(*bounds, next_slots[part]) for part, bounds in enumerate(ranges)])
    hits = refined.as_hits(ids, (total,), mesh=tree.mesh, scene_surface=tree.scene_surface)
    return AllHits._of(hits, offsets, locations)


def find_hits_by_depth(
    caster: Caster,
    batch: RayBatch,
    shape: tuple[int, ...],
    max_hits: int | None,
    progress: Progress | None,
    *,
    with_locations: bool = False,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64] | None]:
    """Return the faces, rays and locations of crossings; see `Tracer.hits_by_depth`."""
    crossings = find_crossings(caster, batch, shape, max_hits, progress)
    offsets = running_sums(crossings.counts)
    total = int(offsets[-1])
    ranges = _cut_evenly(caster.threads, offsets)

    # A counting sort by depth: how many rays of each range reach each depth, and so where its first one goes.
    next_slots = _make_counters(len(ranges), int(crossings.counts.max(initial=0)))
    caster.threads.run(
        _count_depths, [(crossings.counts[slice(*bounds)], next_slots[part]) for part, bounds in enumerate(ranges)]
    )
    by_depth = next_slots.T
    by_depth[:] = np.cumsum(by_depth).reshape(by_depth.shape) - by_depth

    surface = caster.tree.surface
    ids, ray_id = (
        HitIds.make(total, has_instances=caster.tree.hit_dtype == SCENE_HIT, dtype=np.int64),
        np.empty(total, np.int64),
    )
    locations = np.empty((total, 3)) if with_locations else None

    def refine(begin: int, end: int, slots: NDArray[np.int64]) -> None:
        refine_crossings(batch, surface, crossings, begin, end, slots, ids=ids, ray_id=ray_id, locations=locations)

    caster.threads.run(refine, [(*bounds, next_slots[part]) for part, bounds in enumerate(ranges)])
    return ids.prim_id, ray_id, locations


def _cut_evenly(threads: HostThreads, offsets: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return ranges of rays with about equally many crossings."""
    begins = np.searchsorted(offsets, [begin for begin, _ in threads.ranges(int(offsets[-1]))]).tolist()
    return list(itertools.pairwise([0, *begins[1:], len(offsets) - 1]))


def _make_counters(range_count: int, count: int) -> NDArray[np.int64]:
    """Return (range_count, count) zeros, the counters of each range apart from those of the others."""
    return np.zeros((range_count, count + _PADDING), np.int64)[:, :count]


@compiled
def _count_depths(counts, tally):
    for ray in range(len(counts)):
        for depth in range(counts[ray]):
            tally[depth] += 1

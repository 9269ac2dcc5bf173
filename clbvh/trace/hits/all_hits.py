"""Crossings of all rays in their final order, refined on the way there: ray by ray, or depth by depth."""

from __future__ import annotations

import itertools

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from .caster import Caster, Progress
from .crossings import find_crossings, running_sums
from .hits import AllHits
from .rays import RayBatch
from .refine import refine_runs

_NO_LOCATIONS = np.empty((0, 3))
_NO_NUMBERS = np.empty(0)
_NO_RAYS = np.empty(0, np.int64)

# Two cache lines, in numbers of 8 bytes.
_APART = 16


def gather_by_ray(
    caster: Caster,
    mesh: Mesh,
    batch: RayBatch,
    max_hits: int | None,
    progress: Progress | None,
    *,
    with_locations: bool = False,
) -> AllHits:
    """Return the crossings of each ray in the order along it; see `Tracer.all_hits`."""
    crossings = find_crossings(caster, batch, max_hits, progress)
    offsets = running_sums(crossings.counts)
    total = int(offsets[-1])
    hits = AllHits(
        np.empty(total), np.empty(total), np.empty(total), np.empty(total, np.int32), mesh,
        offsets=offsets, known_locations=np.empty((total, 3)) if with_locations else None,
    )  # fmt: skip
    locations = hits.locations if with_locations else _NO_LOCATIONS
    ranges = _cut_evenly(caster, offsets)
    places = _make_counters(len(ranges), 1)
    places[:, 0] = [offsets[begin] for begin, _ in ranges]

    def refine(begin: int, end: int, places: NDArray[np.int64]) -> None:
        refine_runs(
            batch, mesh, crossings, begin, end, places,
            hits.t, hits.u, hits.v, hits.prim_id, _NO_RAYS, locations,
        )  # fmt: skip

    caster.threads.run(refine, [(*rows, places[number]) for number, rows in enumerate(ranges)])
    return hits


def gather_by_depth(
    caster: Caster,
    mesh: Mesh,
    batch: RayBatch,
    max_hits: int | None,
    progress: Progress | None,
    *,
    with_locations: bool = False,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64] | None]:
    """Return the faces, rays and locations of crossings; see `Tracer.hits_by_depth`."""
    crossings = find_crossings(caster, batch, max_hits, progress)
    offsets = running_sums(crossings.counts)
    total = int(offsets[-1])
    ranges = _cut_evenly(caster, offsets)

    # How many rays of each range get as deep as each depth, and so where it puts the first of them.
    places = _make_counters(len(ranges), int(crossings.counts.max(initial=0)))
    caster.threads.run(
        _count_depths, [(crossings.counts[slice(*rows)], places[number]) for number, rows in enumerate(ranges)]
    )
    by_depth = places.T
    by_depth[:] = np.cumsum(by_depth).reshape(by_depth.shape) - by_depth

    prim_id, ray_id = np.empty(total, np.int64), np.empty(total, np.int64)
    locations = np.empty((total, 3)) if with_locations else None
    fields = _NO_NUMBERS, _NO_NUMBERS, _NO_NUMBERS, prim_id, ray_id, _NO_LOCATIONS if locations is None else locations

    def refine(begin: int, end: int, places: NDArray[np.int64]) -> None:
        refine_runs(batch, mesh, crossings, begin, end, places, *fields)

    caster.threads.run(refine, [(*rows, places[number]) for number, rows in enumerate(ranges)])
    return prim_id, ray_id, locations


def _cut_evenly(caster: Caster, offsets: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return where ranges of rays begin and end that have about equally many crossings."""
    bounds = np.searchsorted(offsets, [begin for begin, _ in caster.threads.ranges(int(offsets[-1]))]).tolist()
    return list(itertools.pairwise([0, *bounds[1:], len(offsets) - 1]))


def _make_counters(range_count: int, count: int) -> NDArray[np.int64]:
    """Return (range_count, count) zeros. Rows that threads count in lie apart: in one cache line they cost all gain."""
    return np.zeros((range_count, count + _APART), np.int64)[:, :count]


@njit(cache=True, nogil=True)
def _count_depths(counts, tally):  # type: ignore[no-untyped-def]
    for ray in range(len(counts)):
        for depth in range(counts[ray]):
            tally[depth] += 1

"""All crossings of all rays: the first few in one traversal, and count, scan, fill for the rays that have more.

Bounded memory on the device, whatever the number of crossings.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import HIT, NO_PRIM
from .caster import Caster, Progress
from .hits import AllHits
from .rays import RayBatch
from .refine import refine_hits

# Crossings on the device at a time: 32 MiB. A single ray with more gets what it needs.
MOST_CROSSINGS = 2**21

# Crossings that each ray has places for in the first traversal. A second one counts those of the rays that fill them,
# a third one fetches them; so few rays of real meshes should.
FIRST_PLACES = 8

# What stands for "all of them" in a kernel.
NO_LIMIT = np.iinfo(np.int32).max

_COUNT = np.dtype(np.int32)


def count_crossings(
    caster: Caster, batch: RayBatch, max_hits: int | None, progress: Progress | None
) -> NDArray[np.int32]:
    """Return (n,) int32: how often each ray crosses the mesh, `max_hits` at most."""
    counts = np.empty(len(batch), np.int32)
    for begin, end in caster.ray_chunks(batch, progress):
        with caster.cast("count_hits", end - begin, _COUNT, np.int32(max_hits or NO_LIMIT)) as found:
            counts[begin:end] = found
    return counts


def find_crossings(
    caster: Caster, mesh: Mesh, batch: RayBatch, max_hits: int | None, progress: Progress | None
) -> AllHits:
    """Return the crossings of each ray in the order along it, the `max_hits` nearest ones at most."""
    places = min(FIRST_PLACES, max_hits or FIRST_PLACES)
    counts = np.empty(len(batch), np.int64)
    pieces: list[tuple[int, int, NDArray[np.void]]] = []
    for begin, end in caster.ray_chunks(batch, progress, most_rows=max(1, MOST_CROSSINGS // places)):
        part = counts[begin:end]
        found = _find_first(caster, places, part)
        crowded = np.flatnonzero(part == places)
        if len(crowded) and places != max_hits:
            found = _replace(found, part, crowded, *_find_all(caster, batch.take(begin + crowded), max_hits))
        pieces.append((begin, end, found))

    offsets = _running_sums(counts)
    total = int(offsets[-1])
    hits = AllHits(np.empty(total), np.empty(total), np.empty(total), np.empty(total, np.int32), mesh, offsets=offsets)
    for begin, end, found in pieces:
        _refine(caster, mesh, batch, begin, end, found, hits)
    return hits


def _find_first(caster: Caster, places: int, counts: NDArray[np.int64]) -> NDArray[np.void]:
    """Return the first hits of the rays on the device, without gaps; write how many each ray has."""
    with caster.cast("first_hits", len(counts), HIT, np.int32(places), result_count=len(counts) * places) as kept:
        rows = kept.reshape(len(counts), places)
        caster.threads.for_ranges(
            len(counts), lambda first, last: _count_kept(rows["prim_id"][first:last], counts[first:last])
        )
        offsets = _running_sums(counts)
        found = np.empty(offsets[-1], HIT)
        caster.threads.for_ranges(
            len(counts), lambda first, last: _close_gaps(rows[first:last], offsets[first : last + 1], found)
        )
    return found


def _find_all(caster: Caster, batch: RayBatch, max_hits: int | None) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Return the hits of rays without gaps, and how many each ray has: count, scan, fill."""
    counts = count_crossings(caster, batch, max_hits, None).astype(np.int64)
    offsets = _running_sums(counts)
    found = np.empty(offsets[-1], HIT)
    for first, last in _cut(offsets, caster.most_rows):
        caster.upload_rays(batch, first, last)
        device_offsets = caster.session.upload((offsets[first : last + 1] - offsets[first]).astype(np.int32))
        rows = slice(offsets[first], offsets[last])
        try:
            with caster.cast(
                "all_hits", last - first, HIT, device_offsets, result_count=rows.stop - rows.start
            ) as filled:
                found[rows] = filled
        finally:
            caster.session.release(device_offsets)
    return found, counts


def _cut(offsets: NDArray[np.int64], most_rows: int) -> Iterator[tuple[int, int]]:
    """Yield ranges of at most so many rays that have at most MOST_CROSSINGS crossings, or are a single ray."""
    first, ray_count = 0, len(offsets) - 1
    while first < ray_count:
        last = int(np.searchsorted(offsets, offsets[first] + MOST_CROSSINGS, side="right")) - 1
        last = min(max(last, first + 1), first + most_rows, ray_count)
        yield first, last
        first = last


def _replace(
    found: NDArray[np.void],
    counts: NDArray[np.int64],
    crowded: NDArray[np.int64],
    rest: NDArray[np.void],
    rest_counts: NDArray[np.int64],
) -> NDArray[np.void]:
    """Return hits where some rays have all of theirs in the place of their first ones; change their counts."""
    from_rest = np.zeros(len(counts), np.bool_)
    from_rest[crowded] = True
    kept = found[np.repeat(~from_rest, counts)]
    counts[crowded] = rest_counts
    replaced = np.empty(counts.sum(), HIT)
    is_rest = np.repeat(from_rest, counts)
    replaced[is_rest], replaced[~is_rest] = rest, kept
    return replaced


def _refine(
    caster: Caster, mesh: Mesh, batch: RayBatch, begin: int, end: int, found: NDArray[np.void], hits: AllHits
) -> None:
    """Write the crossings of some rays in float64."""
    offsets = hits.offsets
    first_hit = offsets[begin]

    def refine(first: int, last: int) -> None:
        of_rays = offsets[begin + first : begin + last + 1]
        rows = slice(of_rays[0], of_rays[-1])
        refine_hits(
            batch.part(begin + first, begin + last), mesh, found[of_rays[0] - first_hit : of_rays[-1] - first_hit],
            hits.t[rows], hits.u[rows], hits.v[rows], hits.prim_id[rows],
            np.repeat(np.arange(last - first), np.diff(of_rays)),
        )  # fmt: skip
        _keep_order(of_rays, hits.t)

    caster.threads.for_ranges(end - begin, refine)


def _running_sums(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (n + 1,) int64: where each ray's crossings begin, and where the last one's end."""
    offsets = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    return offsets


@njit(cache=True, nogil=True)
def _count_kept(prim_ids, counts):  # type: ignore[no-untyped-def]
    """Count the hits before the first miss of each row."""
    for ray in range(len(prim_ids)):
        count = 0
        while count < prim_ids.shape[1] and prim_ids[ray, count] != NO_PRIM:
            count += 1
        counts[ray] = count


@njit(cache=True, nogil=True)
def _close_gaps(rows, offsets, found):  # type: ignore[no-untyped-def]
    """Copy the hits of each row to where they belong."""
    for ray in range(len(rows)):
        for hit in range(offsets[ray + 1] - offsets[ray]):
            found[offsets[ray] + hit] = rows[ray, hit]


@njit(cache=True, nogil=True)
def _keep_order(offsets, t):  # type: ignore[no-untyped-def]
    """Raise each t to that of the crossing before it on the ray.

    The device's order holds for all queries, so that `all_hits` begins with what `closest_hit` finds. Where two
    crossings are closer than float32 resolves, float64 may see them the other way round.
    """
    for ray in range(len(offsets) - 1):
        for hit in range(offsets[ray] + 1, offsets[ray + 1]):
            t[hit] = max(t[hit], t[hit - 1])

"""All crossings of all rays: the first few in one traversal, and count, scan, fill for the rays that have more.

Bounded memory on the device, whatever the number of crossings.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import HIT, NO_PRIM
from .caster import Caster, Progress
from .hits import AllHits
from .rays import RayBatch
from .refine import refine_runs

# Crossings on the device at a time: 32 MiB. A single ray with more gets what it needs.
MOST_CROSSINGS = 2**21

# Crossings that each ray has places for in the first traversal. A second one counts those of the rays that fill them,
# a third one fetches them; so few rays of real meshes should.
FIRST_PLACES = 8

# What stands for "all of them" in a kernel.
NO_LIMIT = np.iinfo(np.int32).max

_COUNT = np.dtype(np.int32)


class _Piece(NamedTuple):
    """The first hits of some rays, one behind the other."""

    begin: int
    end: int
    found: NDArray[np.void]


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
    caster: Caster,
    mesh: Mesh,
    batch: RayBatch,
    max_hits: int | None,
    progress: Progress | None,
    *,
    with_locations: bool = False,
) -> AllHits:
    """Return the crossings of each ray in the order along it, the `max_hits` nearest ones at most."""
    places = min(FIRST_PLACES, max_hits or FIRST_PLACES)
    counts = np.empty(len(batch), np.int64)
    pieces: list[_Piece] = []
    for begin, end in caster.ray_chunks(batch, progress, most_rows=max(1, MOST_CROSSINGS // places)):
        pieces += _find_first(caster, begin, places, counts[begin:end])

    # Rays that fill their places may have more.
    crowded = np.flatnonzero(counts == places) if places != max_hits else np.empty(0, np.int64)
    crowded_batch = batch.take(crowded)
    all_found, all_counts = _find_all(caster, crowded_batch, max_hits)
    first_counts = counts.copy()
    counts[crowded] = all_counts

    begins = np.cumsum(counts) - counts
    total = int(counts.sum())
    hits = AllHits(
        np.empty(total), np.empty(total), np.empty(total), np.empty(total, np.int32), mesh,
        offsets=np.append(begins, total), known_locations=np.empty((total, 3)) if with_locations else None,
    )  # fmt: skip
    fields = (hits.t, hits.u, hits.v, hits.prim_id, np.empty((0, 3)) if not with_locations else hits.locations)

    def refine(piece: _Piece) -> None:
        rows = slice(piece.begin, piece.end)
        rays = batch.part(piece.begin, piece.end)
        refine_runs(rays, mesh, piece.found, first_counts[rows], begins[rows], *fields)

    caster.threads.run(refine, [(piece,) for piece in pieces])
    refine_runs(crowded_batch.part(0, len(crowded)), mesh, all_found, all_counts, begins[crowded], *fields)
    return hits


def _find_first(caster: Caster, begin: int, places: int, counts: NDArray[np.int64]) -> list[_Piece]:
    """Return the first hits of the rays on the device, without gaps, and write how many each ray has."""
    pieces: list[_Piece] = []
    with caster.cast("first_hits", len(counts), HIT, np.int32(places), result_count=len(counts) * places) as kept:
        rows = kept.reshape(len(counts), places)

        def close_gaps(first: int, last: int) -> None:
            found = np.empty(_count_kept(rows["prim_id"][first:last], counts[first:last]), HIT)
            _close_gaps(rows[first:last], counts[first:last], found)
            pieces.append(_Piece(begin + first, begin + last, found))

        caster.threads.for_ranges(len(counts), close_gaps)
    return pieces


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


def _running_sums(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (n + 1,) int64: where each ray's crossings begin, and where the last one's end."""
    offsets = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    return offsets


@njit(cache=True, nogil=True)
def _count_kept(prim_ids, counts):  # type: ignore[no-untyped-def]
    """Write how many hits come before the first miss of each row; return their sum."""
    total = 0
    for ray in range(len(prim_ids)):
        count = 0
        while count < prim_ids.shape[1] and prim_ids[ray, count] != NO_PRIM:
            count += 1
        counts[ray] = count
        total += count
    return total


@njit(cache=True, nogil=True)
def _close_gaps(rows, counts, found):  # type: ignore[no-untyped-def]
    """Copy the hits of each row, one behind the other."""
    place = 0
    for ray in range(len(rows)):
        for hit in range(counts[ray]):
            found[place] = rows[ray, hit]
            place += 1

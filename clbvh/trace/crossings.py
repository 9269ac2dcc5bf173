"""All crossings of all rays: the first few in one traversal, and further ones for the rays that have more.

Bounded memory on the device, whatever the number of crossings.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..layout import HIT, NO_PRIM
from ..simd import prefetch
from .caster import Caster, Progress
from .rays import RayBatch

# Crossings on the device at a time: 32 MiB. A single ray with more gets what it needs.
MOST_CROSSINGS = 2**21

# Crossings that each ray has places for in the first traversal, and those in the second one that fill these. A third
# one counts those of the rays that fill them again, a fourth one fetches them; so few rays of real meshes should.
FIRST_PLACES = 8
MORE_PLACES = 32

# What stands for "all of them" in a kernel.
NO_LIMIT = np.iinfo(np.int32).max

_COUNT = np.dtype(np.int32)

# A hit as 8-byte words, and in which half of which one its face is.
_HIT_WORDS = 2
_PRIM_WORD, _PRIM_SHIFT = 1, 32

# Where the crossings of a ray are: the number of a piece, and the place in it in so many bits.
PLACE_BITS = 40
PLACE_MASK = (1 << PLACE_BITS) - 1

# Where results of a ray go is asked for so many rays ahead.
_AHEAD = 16

_NO_NUMBERS = np.empty(0, np.int64)


class Crossings(NamedTuple):
    """What rays cross, as the device found it.

    Attributes
    ----------
    counts : (n,) int32
        How many crossings each ray has.
    sources : (n,) int64
        Where they are in `found`, one behind the other in the order along the ray: a piece, and a place in it. Anything
        where there is none.
    piece_begins : (pieces,) int64
        Where each piece begins.
    found : (m,) `layout.HIT`
    """

    counts: NDArray[np.int32]
    sources: NDArray[np.int64]
    piece_begins: NDArray[np.int64]
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


def find_crossings(caster: Caster, batch: RayBatch, max_hits: int | None, progress: Progress | None) -> Crossings:
    """Return the crossings of each ray, the `max_hits` nearest ones at most."""
    search = _Search(caster, max_hits, np.zeros(len(batch), np.int32), np.zeros(len(batch), np.int64), [])
    numbers, rest = _NO_NUMBERS, batch
    for places in (FIRST_PLACES, MORE_PLACES):
        numbers = _find_first(search, rest, numbers, places, progress)
        if len(numbers) == 0:
            break
        rest, progress = batch.take(numbers), None
    else:
        _find_all(search, rest, numbers)
    piece_begins = running_sums(np.array([len(piece) for piece in search.pieces], np.int64))
    found = np.empty(piece_begins[-1], HIT)

    def join(begin: int, piece: NDArray[np.void]) -> None:
        found.view(np.int64)[_HIT_WORDS * begin : _HIT_WORDS * (begin + len(piece))] = piece.view(np.int64)

    caster.threads.run(join, list(zip(piece_begins[:-1].tolist(), search.pieces, strict=True)))
    return Crossings(search.counts, search.sources, piece_begins, found)


class _Search(NamedTuple):
    """What is wanted, and what is known so far; see `Crossings`."""

    caster: Caster
    max_hits: int | None
    counts: NDArray[np.int32]
    sources: NDArray[np.int64]
    pieces: list[NDArray[np.void]]


def _find_first(
    search: _Search, batch: RayBatch, names: NDArray[np.int64], most: int, progress: Progress | None
) -> NDArray[np.int64]:
    """Find the nearest crossings of rays, and return the numbers of those that may have more than so many.

    `names` are the numbers of the rays where they are only some of all.
    """
    caster, places = search.caster, min(most, search.max_hits or most)
    crowded = [_NO_NUMBERS]
    for begin, rows in caster.ray_pieces(batch, max(1, MOST_CROSSINGS // places), progress):
        with caster.cast("first_hits", len(rows), HIT, np.int32(places), result_count=len(rows) * places) as kept:
            words = kept.view(np.int64).reshape(len(rows), places, _HIT_WORDS)

            def close_gaps(
                piece: int, first: int, last: int, words: NDArray[np.int64] = words, begin: int = begin,
                rows: NDArray[np.int32] = rows,
            ) -> tuple[NDArray[np.void], NDArray[np.int64]]:  # fmt: skip
                found, full = np.empty((last - first) * places, HIT), np.empty(last - first, np.int64)
                hit_count, full_count = _close_gaps(
                    words[first:last], rows[first:last], begin, names, places == search.max_hits, piece << PLACE_BITS,
                    found.view(np.int64).reshape(-1, _HIT_WORDS), full, search.counts, search.sources,
                )  # fmt: skip
                # What nothing was written to is given back: most places stay empty.
                found.resize(hit_count, refcheck=False)
                return found, full[:full_count].copy()

            ranges = caster.threads.ranges(len(rows))
            parts = caster.threads.run(
                close_gaps, [(len(search.pieces) + part, *bounds) for part, bounds in enumerate(ranges)]
            )
            search.pieces.extend(found for found, _ in parts)
            crowded.extend(full for _, full in parts)
    return np.concatenate(crowded)


def _find_all(search: _Search, batch: RayBatch, numbers: NDArray[np.int64]) -> None:
    """Find the crossings of some rays, however many they are: count, scan, fill."""
    caster = search.caster
    counts = count_crossings(caster, batch, search.max_hits, None)
    offsets = running_sums(counts)
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
    search.counts[numbers] = counts
    search.sources[numbers] = len(search.pieces) << PLACE_BITS | offsets[:-1]
    search.pieces.append(found)


def _cut(offsets: NDArray[np.int64], most_rows: int) -> Iterator[tuple[int, int]]:
    """Yield ranges of at most so many rays that have at most MOST_CROSSINGS crossings, or are a single ray."""
    first, ray_count = 0, len(offsets) - 1
    while first < ray_count:
        last = int(np.searchsorted(offsets, offsets[first] + MOST_CROSSINGS, side="right")) - 1
        last = min(max(last, first + 1), first + most_rows, ray_count)
        yield first, last
        first = last


def running_sums(counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return (n + 1,) int64: where each ray's crossings begin, and where the last one's end."""
    offsets = np.empty(len(counts) + 1, np.int64)
    _sum_up(counts, offsets)
    return offsets


@njit(cache=True, nogil=True)
def _sum_up(counts, offsets):  # type: ignore[no-untyped-def]
    # Three times as fast as numpy's sum of 4-byte numbers in 8 bytes.
    offsets[0] = 0
    for row in range(len(counts)):
        offsets[row + 1] = offsets[row] + counts[row]


@njit(cache=True, nogil=True)
def _close_gaps(  # type: ignore[no-untyped-def]
    words, rows, begin, names, is_enough, piece, found, full, counts, sources
):
    """Copy the hits before the first miss of each ray, one behind the other.

    Rays whose places are all taken are listed instead, unless that is enough. Returns how many hits were copied, and
    how many rays are listed.
    """
    places = words.shape[1]
    hit, listed = 0, 0
    for item in range(len(rows)):
        if len(names) == 0:
            coming = begin + rows[min(item + _AHEAD, len(rows) - 1)]
            prefetch(counts, coming)
            prefetch(sources, coming)
        count = 0
        while count < places and words[item, count, _PRIM_WORD] >> _PRIM_SHIFT != NO_PRIM:
            count += 1
        if count == 0:
            continue
        ray = begin + rows[item]
        if len(names) > 0:
            ray = names[ray]
        if count == places and not is_enough:
            full[listed] = ray
            listed += 1
            continue
        counts[ray], sources[ray] = count, piece | hit
        for place in range(count):
            found[hit, 0], found[hit, 1] = words[item, place, 0], words[item, place, 1]
            hit += 1
    return hit, listed

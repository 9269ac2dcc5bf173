"""All crossings of all rays: count, scan, fill. Bounded memory on the device, whatever the number of crossings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import HIT
from .caster import Caster, Progress
from .hits import AllHits
from .rays import RayBatch
from .refine import refine_hits

# Crossings on the device at a time: 32 MiB. A single ray with more gets what it needs.
MOST_CROSSINGS = 2**21

# What stands for "all of them" in a kernel.
NO_LIMIT = np.iinfo(np.int32).max

_COUNT = np.dtype(np.int32)
_FIELDS = ("t", "u", "v", "prim_id")


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
    offsets = np.zeros(len(batch) + 1, np.int64)
    pieces = [AllHits(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int32), mesh)]
    for begin, end in caster.ray_chunks(batch, progress):
        with caster.cast("count_hits", end - begin, _COUNT, np.int32(max_hits or NO_LIMIT)) as counts:
            np.cumsum(counts, out=offsets[begin + 1 : end + 1])
        local = np.concatenate(([0], offsets[begin + 1 : end + 1]))
        for first, last in _cut(local):
            if (first, last) != (0, end - begin):
                caster.upload_rays(batch, begin + first, begin + last)
            pieces.append(_fill(caster, mesh, batch, begin + first, local[first : last + 1] - local[first]))
        offsets[begin + 1 : end + 1] += offsets[begin]
    t, u, v, prim_id = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in _FIELDS)
    return AllHits(t, u, v, prim_id, mesh, offsets=offsets)


def _cut(offsets: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield ranges of rays that have at least one and at most MOST_CROSSINGS crossings, or are a single ray."""
    first, ray_count = 0, len(offsets) - 1
    while first < ray_count and offsets[first] < offsets[-1]:
        last = int(np.searchsorted(offsets, offsets[first] + MOST_CROSSINGS, side="right")) - 1
        last = min(max(last, first + 1), ray_count)
        if offsets[last] > offsets[first]:
            yield first, last
        first = last


def _fill(caster: Caster, mesh: Mesh, batch: RayBatch, begin: int, offsets: NDArray[np.int64]) -> AllHits:
    """Return the crossings of the rays that are on the device, `begin` the first one's number in the batch."""
    ray_count, hit_count = len(offsets) - 1, int(offsets[-1])
    piece = AllHits(
        np.empty(hit_count), np.empty(hit_count), np.empty(hit_count), np.empty(hit_count, np.int32), mesh,
        offsets=offsets,
    )  # fmt: skip
    rays = batch.part(begin, begin + ray_count)
    device_offsets = caster.session.upload(offsets.astype(np.int32))
    try:
        with caster.cast("all_hits", ray_count, HIT, device_offsets, result_count=hit_count) as found:

            def refine(first: int, last: int) -> None:
                rows = slice(offsets[first], offsets[last])
                refine_hits(
                    rays, mesh, found[rows], piece.t[rows], piece.u[rows], piece.v[rows], piece.prim_id[rows],
                    np.repeat(np.arange(first, last), np.diff(offsets[first : last + 1])),
                )  # fmt: skip
                _keep_order(offsets[first : last + 1], piece.t)

            caster.threads.for_ranges(ray_count, refine)
    finally:
        caster.session.release(device_offsets)
    return piece


@njit(cache=True, nogil=True)
def _keep_order(offsets, t):  # type: ignore[no-untyped-def]
    """Raise each t to that of the crossing before it on the ray.

    The device's order holds for all queries, so that `all_hits` begins with what `closest_hit` finds. Where two
    crossings are closer than float32 resolves, float64 may see them the other way round.
    """
    for ray in range(len(offsets) - 1):
        for hit in range(offsets[ray] + 1, offsets[ray + 1]):
            t[hit] = max(t[hit], t[hit - 1])

"""All hits of each ray, in two steps: the device finds the crossings, and the host refines them in float64, ray by ray.

One kernel keeps the nearest few hits of each ray; rays that may have more are cast again with four times the room,
until none has. What comes back is compacted, so memory is bounded by the hits that exist, and by a constant on the
device.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...support.host_threads import HostThreads
from ..launch import Caster
from ..rays.batch import RayBatch, check_room
from ..rays.pieces import Piece, Progress
from ..world.surface_arrays import SurfaceArrays
from .hits import AllHits
from .refine import LEAST_HITS, RefinedHits
from .search import FIRST_HITS, Rays, cast_rays
from .surface import Surface

# Slots of each ray in the first round, and their growth from round to round. Few rays of real meshes need a second one.
FIRST_SLOTS = 8
SLOT_GROWTH = 4

# Count and source of a ray.
_RAY_BYTES = 12

# The source of a ray's crossings: the number of a segment, and the offset in it in this many bits.
OFFSET_BITS = 40
OFFSET_MASK = (1 << OFFSET_BITS) - 1

_LOOPS = Loops("hits/all_hits")


class Crossings(NamedTuple):
    """The crossings of rays, as the device found them.

    Attributes
    ----------
    counts : (n,) int32
        Crossings of each ray.
    sources : (n,) int64
        Index of a ray's first crossing in `found`, as a segment and an offset; anything for a ray without crossings.
        The others follow in the order along the ray.
    segment_begins : (segments + 1,) int64
        Begin of each segment in `found`.
    found : (m,) `structs.HIT` or `structs.WORLD_HIT`
    """

    counts: NDArray[np.int32]
    sources: NDArray[np.int64]
    segment_begins: NDArray[np.int64]
    found: NDArray[np.void]


@dataclass
class _Search:
    """A search for crossings: the request, and the results so far; see `Crossings`."""

    max_hits: int | None
    most_slots: int
    counts: NDArray[np.int32]
    sources: NDArray[np.int64]
    segments: list[NDArray[np.int64]] = field(default_factory=list)


def find_crossings(caster: Caster, batch: RayBatch, max_hits: int | None, progress: Progress | None) -> Crossings:
    """Return the crossings of each ray, the nearest `max_hits` at most."""
    count, dtype = batch.ray_count, caster.world.hit_dtype
    check_room(count, _RAY_BYTES)
    # One slot more than a ray can have crossings is never taken.
    search = _Search(max_hits, caster.world.most_hits + 1, np.zeros(count, np.int32), np.zeros(count, np.int64))
    slots = min(FIRST_SLOTS, search.most_slots)
    cast_rays(caster, batch, lambda rays: _search(search, rays, slots), progress, slots)

    segments = search.segments
    segment_begins = running_sums(np.array([len(segment) for segment in segments], np.int64))
    found = segments[0] if len(segments) == 1 else np.empty((segment_begins[-1], dtype.itemsize // 8), np.int64)

    def join(begin: int, segment: NDArray[np.int64]) -> None:
        found[begin : begin + len(segment)] = segment

    if len(segments) > 1:
        caster.threads.run(join, list(zip(segment_begins[:-1].tolist(), segments, strict=True)))
    return Crossings(search.counts, search.sources, segment_begins, found.view(dtype).reshape(-1))


def _search(search: _Search, rays: Rays, slots: int) -> None:
    """Find the nearest crossings of a piece of rays, and more of those whose slots are all taken."""
    wanted = slots if search.max_hits is None else min(slots, search.max_hits)
    for piece in rays.piece.split(rays.find_room(wanted)):
        with rays._replace(piece=piece).find(FIRST_HITS, wanted) as kept:
            crowded = _compact(
                search, rays.caster.threads, piece, kept.view(np.int64).reshape(-1, wanted, kept.dtype.itemsize // 8)
            )
        if len(crowded):
            _search(search, rays._replace(piece=piece.only(crowded)), min(slots * SLOT_GROWTH, search.most_slots))


def _compact(search: _Search, threads: HostThreads, piece: Piece, kept: NDArray[np.int64]) -> NDArray[np.int32]:
    """Add the hits of a piece to the search, without gaps; return its crowded rays, counted from its begin."""
    slots, words, ray_ids = kept.shape[1], kept.shape[2], piece.item_ids()
    counts, sources = search.counts[piece.begin :], search.sources[piece.begin :]

    def compact(segment: int, first: int, last: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        hits, crowded = np.empty(((last - first) * slots, words), np.int64), np.empty(last - first, np.int32)
        crowded_count = np.empty(1, np.int64)
        hit_count = _LOOPS.compact(
            kept[first:last], slots, words, ray_ids[first:last], slots == search.max_hits, segment << OFFSET_BITS,
            hits, crowded, crowded_count, counts, sources,
        )  # fmt: skip
        # Most slots are empty: their memory is given back.
        hits.resize((hit_count, words), refcheck=False)
        return hits, crowded[: crowded_count[0]].copy()

    ranges = threads.ranges(len(kept), LEAST_HITS)
    parts = threads.run(compact, [(len(search.segments) + part, *bounds) for part, bounds in enumerate(ranges)])
    search.segments += [hits for hits, _ in parts]
    return parts[0][1] if len(parts) == 1 else np.concatenate([crowded for _, crowded in parts])


def running_sums(counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return (n + 1,) int64: the sum of the counts before each one, and of all."""
    offsets = np.zeros(len(counts) + 1, np.int64)
    counts.cumsum(out=offsets[1:])
    return offsets


def find_all_hits(
    caster: Caster,
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
    world = caster.world
    refined = RefinedHits.make(total, is_lone=world.is_lone)
    locations = np.empty((total, 3)) if with_locations else None

    def refine(begin: int, end: int) -> None:
        refine_rays(batch, world.arrays, crossings, begin, end, int(offsets[begin]), refined, locations)

    # Ranges of rays with about equally many crossings.
    begins = np.searchsorted(offsets, [begin for begin, _ in caster.threads.ranges(total, LEAST_HITS)]).tolist()
    caster.threads.run(refine, list(itertools.pairwise([0, *begins[1:], batch.ray_count])))
    hits = refined.as_hits(Surface.of_world(world))
    return AllHits(**vars(hits), offsets=offsets, known_locations=locations)


def refine_rays(
    batch: RayBatch,
    arrays: SurfaceArrays,
    crossings: Crossings,
    begin: int,
    end: int,
    first_slot: int,
    hits: RefinedHits,
    locations: NDArray[np.float64] | None,
) -> None:
    """Write the hits of rays `begin` to `end` in float64, ray after ray, from `first_slot` on.

    With one mesh, no t is smaller than that of the crossing before it on the ray. The device's order holds for all
    queries, so that `all_hits` begins with what `closest_hit` finds; float64 may see two crossings that are closer than
    float32 resolves in the other order. In a scene, the hits of a ray are in the order of t in float64: the device
    resolves the distance of two instances less the farther they are from the ray's origin.
    """
    of_kind = (crossings.found, None) if arrays.is_lone else (None, crossings.found)
    _LOOPS.refine_rays(
        arrays.addresses, batch.addresses, begin, *of_kind, crossings.segment_begins, crossings.counts[begin:end],
        crossings.sources[begin:end], first_slot, *hits, locations,
    )  # fmt: skip
    if not arrays.is_lone:
        _LOOPS.sort_by_t(crossings.counts[begin:end], first_slot, *hits, locations)


def keep_order(counts: NDArray[np.int32], first_slot: int, t: NDArray[np.float64]) -> None:
    """Raise each t, from a slot on, to that of the hit before it on the ray, given the hits of each ray."""
    _LOOPS.keep_order(counts, first_slot, t)

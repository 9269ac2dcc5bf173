"""One range of primitives falls into two: what every rung does at every node, and the three ways to do it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..options import MAX_BINS, MAX_DEPTH
from .order import select, sort_range
from .prims import BOX, bound_prim, centroid_of

# The ways to find the two halves.
SORT = 0  # sort the whole range, cut in the middle
SELECT = 1  # find the median, cut there
BINS = 2  # count the range in bins, cut at the boundary next to the median


class Rule(NamedTuple):
    """What a rung does at a node.

    Attributes
    ----------
    how : int
        SORT, SELECT or BINS.
    bins : int
        Number of bins, for BINS.
    leaf_size : int
        A range of at most this many primitives becomes a leaf.
    copies : bool
        Whether each node gets a list of primitives of its own.
    """

    how: int
    bins: int
    leaf_size: int
    copies: bool


class Scratch(NamedTuple):
    """Memory that one task uses again for every node.

    Attributes
    ----------
    ids : (n,) int32
    bounds : (2, 6) float32
        Row 0: the box of the range at hand. Row 1: the box of its centroids.
    counts : (MAX_BINS,) int64
    """

    ids: NDArray[np.int32]
    bounds: NDArray[np.float32]
    counts: NDArray[np.int64]


def make_scratch(count: int) -> Scratch:
    """Return scratch memory for ranges of up to `count` primitives."""
    return Scratch(np.empty(count, np.int32), np.empty((2, BOX), np.float32), np.empty(MAX_BINS, np.int64))


@njit(cache=True, nogil=True)
def bound_range(prims, ids, begin, end, bounds):  # type: ignore[no-untyped-def]
    """Write the box of ids[begin:end] into row 0 of `bounds`, and the box of their centroids into row 1."""
    for axis in range(3):
        for row in range(2):
            bounds[row, axis] = np.inf
            bounds[row, axis + 3] = -np.inf
    for place in range(begin, end):
        prim = ids[place]
        box = bound_prim(prims, prim)
        for axis in range(3):
            centroid = centroid_of(prims, prim, axis)
            bounds[0, axis] = min(bounds[0, axis], box[axis])
            bounds[0, axis + 3] = max(bounds[0, axis + 3], box[axis + 3])
            bounds[1, axis] = min(bounds[1, axis], centroid)
            bounds[1, axis + 3] = max(bounds[1, axis + 3], centroid)


@njit(cache=True, nogil=True)
def divide(prims, ids, begin, end, depth, rule, scratch):  # type: ignore[no-untyped-def]
    """Reorder ids[begin:end], at least two, so that the left child's primitives come first.

    Parameters
    ----------
    prims : Recomputed or Cached
    ids : (n,) int32, changed in place
    depth : int
        The depth of the node that owns the range.
    rule : Rule
    scratch : Scratch
        `bound_range` has filled its bounds.

    Returns
    -------
    int
        Where the right child's primitives begin.
    """
    middle = begin + (end - begin) // 2
    axis, extent = _longest_axis(scratch.bounds)
    if rule.how == SORT:
        sort_range(prims, ids, begin, end, axis, scratch.ids)
    elif rule.how == SELECT:
        select(prims, ids, begin, end, middle, axis, scratch.ids)
    elif extent > 0 and not _needs_halving(end - begin, depth):
        middle = _partition(prims, ids, begin, end, axis, extent, rule.bins, scratch)
    # Otherwise all centroids fall into one bin, or no level is left for uneven halves: the cut goes through the
    # median of the primitive ids, by which every range of a partitioning rung is ordered.
    return middle


@njit(cache=True, nogil=True)
def list_prims(ids, begin, end, first, prim_ids):  # type: ignore[no-untyped-def]
    """Write ids[begin:end] to prim_ids[first:], by primitive id; the two may be the same place.

    O(n) for a range that is in order already, as the large leaves of `frontier` are.
    """
    for index in range(end - begin):
        prim = ids[begin + index]
        place = first + index
        while place > first and prim_ids[place - 1] > prim:
            prim_ids[place] = prim_ids[place - 1]
            place -= 1
        prim_ids[place] = prim


@njit(cache=True, nogil=True)
def _longest_axis(bounds):  # type: ignore[no-untyped-def]
    """Return the axis along which the centroids lie furthest apart, the lowest of several, and how far."""
    # In float64: extents of a mesh that fills float32 do not fit it.
    longest, axis = np.float64(bounds[1, 3]) - bounds[1, 0], 0
    for other in range(1, 3):
        extent = np.float64(bounds[1, other + 3]) - bounds[1, other]
        if extent > longest:
            longest, axis = extent, other
    return axis, longest


@njit(cache=True, nogil=True)
def _needs_halving(prim_count, depth):  # type: ignore[no-untyped-def]
    """Say whether only splits by halves still keep `prim_count` primitives above MAX_DEPTH."""
    levels = 0
    while (1 << levels) < prim_count:
        levels += 1
    return levels >= MAX_DEPTH - depth


@njit(cache=True, nogil=True)
def _bin_of(prims, prim, axis, lower, scale, bins):  # type: ignore[no-untyped-def]
    return min(int((np.float64(centroid_of(prims, prim, axis)) - lower) * scale), bins - 1)


@njit(cache=True, nogil=True)
def _partition(prims, ids, begin, end, axis, extent, bins, scratch):  # type: ignore[no-untyped-def]
    """Cut the range at the bin boundary next to its median; both sides keep their order."""
    lower, scale = np.float64(scratch.bounds[1, axis]), bins / extent
    counts, others = scratch.counts, scratch.ids
    counts[:bins] = 0
    for place in range(begin, end):
        counts[_bin_of(prims, ids[place], axis, lower, scale, bins)] += 1

    # The first and the last bin are never empty, so each boundary leaves something on both sides.
    below, last_left_bin, left_count = counts[0], 0, counts[0]
    for index in range(1, bins - 1):
        below += counts[index]
        if abs(2 * below - (end - begin)) < abs(2 * left_count - (end - begin)):
            last_left_bin, left_count = index, below

    place, other_count = begin, 0
    for index in range(begin, end):
        prim = ids[index]
        if _bin_of(prims, prim, axis, lower, scale, bins) <= last_left_bin:
            ids[place] = prim
            place += 1
        else:
            others[other_count] = prim
            other_count += 1
    for index in range(other_count):
        ids[place + index] = others[index]
    return place

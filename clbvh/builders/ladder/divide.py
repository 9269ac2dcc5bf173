"""One range of primitives is divided in two: the step of every variant at every node, in three ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from ..halving import middle_of, needs_halving
from ..leaf_prims import insert_prim
from ..options import MAX_BINS
from .halves import SELECT, SORT
from .order import select, sort_range
from .prims import BOX, bound_prim, centroid_of


class Rule(NamedTuple):
    """How a variant divides a node.

    Attributes
    ----------
    how : int
        SORT, SELECT or BINS, of `halves`.
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


class Task(NamedTuple):
    """A range of primitives of the whole tree, and the depth of its node."""

    begin: int
    end: int
    depth: int


class Scratch(NamedTuple):
    """Memory of one task, used again for every node.

    Attributes
    ----------
    ids : (n,) int32
    bounds : (2, 6) float32
        Row 0: the box of the current range. Row 1: the box of its centroids.
    counts : (MAX_BINS,) int64
    """

    ids: NDArray[np.int32]
    bounds: NDArray[np.float32]
    counts: NDArray[np.int64]


def make_scratch(count: int) -> Scratch:
    """Return scratch memory for ranges of up to `count` primitives."""
    return Scratch(np.empty(count, np.int32), np.empty((2, BOX), np.float32), np.empty(MAX_BINS, np.int64))


@compiled
def bound_range(prims, ids, begin, end, bounds):
    """Write the box of ids[begin:end] into row 0 of `bounds`, and the box of their centroids into row 1."""
    for axis in range(3):
        for row in range(2):
            bounds[row, axis] = np.inf
            bounds[row, axis + 3] = -np.inf
    for index in range(begin, end):
        prim = ids[index]
        box = bound_prim(prims, prim)
        for axis in range(3):
            centroid = centroid_of(prims, prim, axis)
            bounds[0, axis] = min(bounds[0, axis], box[axis])
            bounds[0, axis + 3] = max(bounds[0, axis + 3], box[axis + 3])
            bounds[1, axis] = min(bounds[1, axis], centroid)
            bounds[1, axis + 3] = max(bounds[1, axis + 3], centroid)


@compiled
def divide(prims, ids, begin, end, depth, rule, scratch):
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
        Index of the right child's first primitive.
    """
    middle = middle_of(begin, end)
    axis, extent = _longest_axis(scratch.bounds)
    if rule.how == SORT:
        sort_range(prims, ids, begin, end, axis, scratch.ids)
    elif rule.how == SELECT:
        select(prims, ids, begin, end, middle, axis, scratch.ids)
    elif extent > 0 and not needs_halving(end - begin, depth):
        middle = _partition(prims, ids, begin, end, axis, extent, rule.bins, scratch)
    # Otherwise all centroids fall into one bin, or no level is left for uneven halves: the cut goes through the
    # median of the primitive ids, by which every range of a partitioning variant is ordered.
    return middle


@compiled
def list_prims(ids, begin, end, first, prim_ids):
    """Write ids[begin:end] to prim_ids[first:], in ascending order; both may be the same memory.

    O(n) for a range that is in order already, as the large leaves of `frontier` are.
    """
    for index in range(end - begin):
        insert_prim(prim_ids, first, first + index, ids[begin + index])


@compiled
def _longest_axis(bounds):
    """Return the axis along which the centroids lie furthest apart, the lowest of several, and how far."""
    # In float64: extents of a mesh that fills float32 do not fit it.
    longest, axis = np.float64(bounds[1, 3]) - bounds[1, 0], 0
    for other in range(1, 3):
        extent = np.float64(bounds[1, other + 3]) - bounds[1, other]
        if extent > longest:
            longest, axis = extent, other
    return axis, longest


@compiled
def _bin_of(prims, prim, axis, lower, scale, bins):
    return min(int((np.float64(centroid_of(prims, prim, axis)) - lower) * scale), bins - 1)


@compiled
def _partition(prims, ids, begin, end, axis, extent, bins, scratch):
    """Cut the range at the bin boundary next to its median; both sides keep their order."""
    lower, scale = np.float64(scratch.bounds[1, axis]), bins / extent
    counts, others = scratch.counts, scratch.ids
    counts[:bins] = 0
    for index in range(begin, end):
        counts[_bin_of(prims, ids[index], axis, lower, scale, bins)] += 1

    # The first and the last bin are never empty, so each boundary leaves something on both sides.
    below, last_left_bin, left_count = counts[0], 0, counts[0]
    for index in range(1, bins - 1):
        below += counts[index]
        if abs(2 * below - (end - begin)) < abs(2 * left_count - (end - begin)):
            last_left_bin, left_count = index, below

    middle, other_count = begin, 0
    for index in range(begin, end):
        prim = ids[index]
        if _bin_of(prims, prim, axis, lower, scale, bins) <= last_left_bin:
            ids[middle] = prim
            middle += 1
        else:
            others[other_count] = prim
            other_count += 1
    for index in range(other_count):
        ids[middle + index] = others[index]
    return middle

"""One range of primitives is divided in two: the step of every variant at every node, in three ways.

Boxes and centroids come from the mesh, each time anew, as in the first three variants, or from arrays filled before.
The rest of the ladder asks `bound_prim` and `centroid_of` and does not know which; numba compiles it once for each. So
it also runs on a source that counts (`clbvh.study.ladder_work`). Equal centroids are ordered by primitive id: there is
one order, whichever algorithm finds it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...support.compiled import compiled
from ..invariants import insert_prim, middle_of, needs_halving
from ..options import MAX_BINS
from .variants import SELECT, SORT

# A box is (min_x, min_y, min_z, max_x, max_y, max_z).
BOX = 6


class Recomputed(NamedTuple):
    """The mesh itself: boxes and centroids are computed from the corners each time."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


class Cached(NamedTuple):
    """One box, (n, 6), and one centroid, (n, 3), per primitive, computed once."""

    aabbs: NDArray[np.float32]
    centroids: NDArray[np.float32]


def bound_prim(prims: Recomputed | Cached, prim: int) -> tuple[np.float32, ...]:
    """Return the box of a primitive; for compiled code only."""
    raise NotImplementedError


def centroid_of(prims: Recomputed | Cached, prim: int, axis: int) -> np.float32:
    """Return one coordinate of a primitive's centroid, the centre of its box; for compiled code only."""
    raise NotImplementedError


@compiled
def _bound_corners(vertices, faces, prim, axis):
    a, b, c = vertices[faces[prim, 0], axis], vertices[faces[prim, 1], axis], vertices[faces[prim, 2], axis]
    # Adding zero turns -0.0 into 0.0: which of the two a minimum gives would depend on the order of the primitives.
    return min(a, b, c) + np.float32(0.0), max(a, b, c) + np.float32(0.0)


@compiled
def _centre(lower, upper):
    # Halved before they are added: the sum of two large coordinates would overflow.
    return np.float32(0.5) * lower + np.float32(0.5) * upper


@overload(bound_prim)
def _bound_prim(prims, prim):
    if prims.instance_class is Cached:

        def bound(prims, prim):
            aabbs = prims.aabbs
            return aabbs[prim, 0], aabbs[prim, 1], aabbs[prim, 2], aabbs[prim, 3], aabbs[prim, 4], aabbs[prim, 5]

        return bound

    if prims.instance_class is Recomputed:

        def bound(prims, prim):
            min_x, max_x = _bound_corners(prims.vertices, prims.faces, prim, 0)
            min_y, max_y = _bound_corners(prims.vertices, prims.faces, prim, 1)
            min_z, max_z = _bound_corners(prims.vertices, prims.faces, prim, 2)
            return min_x, min_y, min_z, max_x, max_y, max_z

        return bound

    return None


@overload(centroid_of)
def _centroid_of(prims, prim, axis):
    if prims.instance_class is Cached:

        def centroid(prims, prim, axis):
            return prims.centroids[prim, axis]

        return centroid

    if prims.instance_class is Recomputed:

        def centroid(prims, prim, axis):
            # The whole box, as the report's comparison does, although one axis of it is asked for.
            box = bound_prim(prims, prim)
            return _centre(box[axis], box[axis + 3])

        return centroid

    return None


@compiled
def fill_cache(vertices, faces, begin, end, aabbs, centroids):
    """Write the boxes and centroids of the primitives from `begin` to `end`.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (n, 3) int32
    aabbs : (n, 6) float32, written
    centroids : (n, 3) float32, written
    """
    for prim in range(begin, end):
        for axis in range(3):
            lower, upper = _bound_corners(vertices, faces, prim, axis)
            aabbs[prim, axis] = lower
            aabbs[prim, axis + 3] = upper
            centroids[prim, axis] = _centre(lower, upper)


# Runs of this many primitives are sorted by insertion before they are merged, as sorting libraries do.
_RUN = 8


@compiled
def comes_before(prims, one, other, axis):
    """Say whether primitive `one` lies before primitive `other`."""
    here, there = centroid_of(prims, one, axis), centroid_of(prims, other, axis)
    return here < there or (here == there and one < other)


@compiled
def sort_range(prims, ids, begin, end, axis, scratch):
    """Sort ids[begin:end] along an axis, in O(n log n) comparisons whatever the input.

    Parameters
    ----------
    prims : Recomputed or Cached
    ids : (n,) int32, changed in place
    scratch : (>= end - begin,) int32, overwritten
    """
    for first in range(begin, end, _RUN):
        for index in range(first + 1, min(first + _RUN, end)):
            prim = ids[index]
            slot = index
            while slot > first and comes_before(prims, prim, ids[slot - 1], axis):
                ids[slot] = ids[slot - 1]
                slot -= 1
            ids[slot] = prim
    # Merge neighbours: the left run moves to the scratch memory, so that the merged one can overwrite both.
    width = _RUN
    while width < end - begin:
        for first in range(begin, end - width, 2 * width):
            for index in range(width):
                scratch[index] = ids[first + index]
            left, right, right_end = 0, first + width, min(first + 2 * width, end)
            slot = first
            while left < width:
                if right < right_end and comes_before(prims, ids[right], scratch[left], axis):
                    ids[slot] = ids[right]
                    right += 1
                else:
                    ids[slot] = scratch[left]
                    left += 1
                slot += 1
        width *= 2


@compiled
def select(prims, ids, begin, end, middle, axis, scratch):
    """Move the primitives that a sort would put before `middle` there, in any order, and the others behind them.

    Hoare's selection, O(n) for nearly every input (C. A. R. Hoare, "Algorithm 65: find", 1961). When too
    many rounds have not ended it, a sort of the rest bounds it, as in Musser's introselect (1997).
    """
    low, high = begin, end - 1
    rounds_left = 0
    while (1 << rounds_left) < end - begin:
        rounds_left += 1
    rounds_left *= 2
    while low < high:
        if rounds_left == 0:
            sort_range(prims, ids, low, high + 1, axis, scratch)
            return
        rounds_left -= 1
        # The median of three as pivot.
        pivot, centre, last = ids[low], ids[(low + high) // 2], ids[high]
        if comes_before(prims, centre, pivot, axis):
            pivot, centre = centre, pivot
        if comes_before(prims, last, centre, axis):
            centre = pivot if comes_before(prims, last, pivot, axis) else last
        pivot = centre
        # Everything up to `right` comes before everything from `left` on; between them at most the pivot.
        left, right = low, high
        while left <= right:
            while comes_before(prims, ids[left], pivot, axis):
                left += 1
            while comes_before(prims, pivot, ids[right], axis):
                right -= 1
            if left <= right:
                ids[left], ids[right] = ids[right], ids[left]
                left += 1
                right -= 1
        if middle <= right:
            high = right
        elif middle >= left:
            low = left
        else:
            return


class Rule(NamedTuple):
    """How a variant divides a node.

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

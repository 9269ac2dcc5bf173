"""The order of primitives along an axis: a full sort, and the selection of the median alone.

Equal centroids are ordered by primitive id, so that there is one order, whichever algorithm finds it.
"""

from __future__ import annotations

from ...support.compiled import compiled
from .prims import centroid_of

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

"""The order of primitives along an axis: a full sort, and the selection of the median alone.

Equal centroids are ordered by primitive id, so that there is one order, whichever algorithm finds it.
"""

from __future__ import annotations

from numba import njit

from .prims import centroid_of

# Runs of this many primitives are sorted by insertion before they are merged, as sorting libraries do.
_RUN = 8


@njit(cache=True, nogil=True)
def comes_before(prims, one, other, axis):  # type: ignore[no-untyped-def]
    """Say whether primitive `one` lies before primitive `other`."""
    here, there = centroid_of(prims, one, axis), centroid_of(prims, other, axis)
    return here < there or (here == there and one < other)


@njit(cache=True, nogil=True)
def sort_range(prims, ids, begin, end, axis, scratch):  # type: ignore[no-untyped-def]
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
            place = index
            while place > first and comes_before(prims, prim, ids[place - 1], axis):
                ids[place] = ids[place - 1]
                place -= 1
            ids[place] = prim
    # Merge neighbours: the left run steps aside, so that the merged one fits in its place.
    width = _RUN
    while width < end - begin:
        for first in range(begin, end - width, 2 * width):
            for index in range(width):
                scratch[index] = ids[first + index]
            left, right, right_end = 0, first + width, min(first + 2 * width, end)
            place = first
            while left < width:
                if right < right_end and comes_before(prims, ids[right], scratch[left], axis):
                    ids[place] = ids[right]
                    right += 1
                else:
                    ids[place] = scratch[left]
                    left += 1
                place += 1
        width *= 2


@njit(cache=True, nogil=True)
def select(prims, ids, begin, end, middle, axis, scratch):  # type: ignore[no-untyped-def]
    """Move the primitives that a sort would put before `middle` there, in any order, and the others behind them.

    Hoare's selection, O(n) for nearly every input (C. A. R. Hoare, "Algorithm 65: find", 1961). When it does not
    come near its end in time, a sort of what is left bounds it, as in Musser's introselect (1997).
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

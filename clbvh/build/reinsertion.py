"""Subtrees move to where they enlarge the boxes least.

After Bittner, Hapala and Havran, "Fast insertion-based optimization of bounding volume hierarchies" (2013), with the
search of Meister and Bittner, "Parallel reinsertion for bounding volume hierarchy optimization" (2018): it starts at
the place that the subtree leaves and spreads from there, so most of it stays nearby. What counts is the summed area of
the interior nodes' boxes; a subtree that moves takes its own share along, and the leaves' never change.

The rows are those of `unfold`. All that happens below one row happens in the rows below it, so threads can work on
subtrees that do not overlap.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..simd import LANES, half_area, load_row, store_row, unite
from .unfold import LINK, PRIM

# A search that has seen so many rows takes the best place so far. The mean is about 20 on scans and 40 on overlapping
# boxes; the limit is for triangles that all overlap, where a search would see the whole tree.
_MOST_STEPS = 2048

# What a search has pushed and not seen yet: two rows for each one seen.
_STACK_SIZE = 2 * _MOST_STEPS + 4

# A move must save this share of the moved box's area, or rounding alone could move a row to and fro.
_LEAST_GAIN = 1e-6


@njit(cache=True, nogil=True)
def reinsert_below(rows, links, parents, top, order):  # type: ignore[no-untyped-def]
    """Try a better place for each of some rows, one after the other.

    Parameters
    ----------
    rows, links : (2n, 8) float32 and int32, the same memory, rearranged
    parents : (n,) int32, rearranged
    top : int
        Rows that are not below this one are left alone.
    order : (k,) int32
        Rows below `top`.

    Returns
    -------
    int
        How many moved.
    """
    waiting = np.empty(_STACK_SIZE, np.int32)
    savings = np.empty(_STACK_SIZE, np.float64)
    moves = 0
    for node in order:
        if parents[node >> 1] == top:
            continue  # its parent is to stay
        place = _find_place(rows, links, parents, node, top, waiting, savings)
        if place > 0:
            _move(rows, links, parents, node, place, top)
            moves += 1
    return moves


@njit(cache=True, nogil=True)
def _find_place(rows, links, parents, node, top, waiting, savings):  # type: ignore[no-untyped-def]
    """Return the row whose sibling `node` had better be, 0 if it stands well."""
    box = load_row(rows, node)
    area = half_area(box)
    row = parents[node >> 1]
    # Without the node its parent goes, and everything above shrinks.
    rest = load_row(rows, node ^ 1)
    saved = half_area(load_row(rows, row))
    best, place = _LEAST_GAIN * area, 0
    steps = 0
    best, place, steps = _search(rows, links, node ^ 1, box, area, saved, best, place, steps, waiting, savings)
    while row != top:
        sibling = row ^ 1
        best, place, steps = _search(rows, links, sibling, box, area, saved, best, place, steps, waiting, savings)
        row = parents[row >> 1]
        rest = unite(rest, load_row(rows, sibling))
        saved += half_area(load_row(rows, row)) - half_area(rest)
    return place


@njit(cache=True, nogil=True)
def _search(  # type: ignore[no-untyped-def]
    rows, links, start, box, area, saved, best, place, steps, waiting, savings
):
    """Look for a better place at `start` and below it; return the best saving, its row, and the steps so far.

    A place below a row costs what the row's box grows by, and the area of the new parent, which is at least the
    node's own: what is left of the saving bounds the search.
    """
    waiting[0], savings[0] = start, saved
    waiting_count = 1
    while waiting_count > 0 and steps < _MOST_STEPS:
        waiting_count -= 1
        left = savings[waiting_count]
        if not left - area > best:
            continue
        steps += 1
        row = waiting[waiting_count]
        old = load_row(rows, row)
        left -= half_area(unite(old, box))
        if left > best:
            best, place = left, row
        child = links[row, LINK]
        if child != 0:
            left += half_area(old)
            if left - area > best:
                waiting[waiting_count], savings[waiting_count] = child, left
                waiting[waiting_count + 1], savings[waiting_count + 1] = child + 1, left
                waiting_count += 2
    return best, place, steps


@njit(cache=True, nogil=True)
def _move(rows, links, parents, node, place, top):  # type: ignore[no-untyped-def]
    """Make `node` the sibling of what stands at `place`."""
    # The sibling takes the parent's row, what stands at the place takes the sibling's, and the place becomes the
    # parent of the two.
    sibling, parent = node ^ 1, parents[node >> 1]
    _copy_row(links, parents, sibling, parent)
    _copy_row(links, parents, place, sibling)
    links[place, LINK] = min(node, sibling)
    parents[node >> 1] = place

    # Boxes above both, until nothing changes.
    if parent != top:
        _fit_upwards(rows, links, parents, parents[parent >> 1], top)
    _fit_upwards(rows, links, parents, place, top)


@njit(cache=True, nogil=True)
def _copy_row(links, parents, source, target):  # type: ignore[no-untyped-def]
    for lane in range(LANES):
        links[target, lane] = links[source, lane]
    if links[target, LINK] != 0:
        parents[links[target, LINK] >> 1] = target


@njit(cache=True, nogil=True)
def _fit_upwards(rows, links, parents, row, top):  # type: ignore[no-untyped-def]
    while True:
        child = links[row, LINK]
        box = unite(load_row(rows, child), load_row(rows, child + 1))
        store_row(rows, row, box)
        links[row, LINK], links[row, PRIM] = child, 0
        if row == top:
            return
        row = parents[row >> 1]


@njit(cache=True, nogil=True)
def list_rows(links, top, below):  # type: ignore[no-untyped-def]
    """Write the rows below `top`, level by level, and return how many there are.

    Parameters
    ----------
    links : (2n, 8) int32
    top : int
    below : (>= k,) int32, written
    """
    count = seen = 0
    row = top
    while True:
        child = links[row, LINK]
        if child != 0:
            below[count], below[count + 1] = child, child + 1
            count += 2
        if seen == count:
            return count
        row = below[seen]
        seen += 1


@njit(cache=True, nogil=True)
def count_prims(links, order):  # type: ignore[no-untyped-def]
    """Return how many triangles lie below each row, (2n,) int32; `order` has all rows, parents first."""
    sizes = np.empty(len(links), np.int32)
    for index in range(len(order) - 1, -1, -1):
        row = order[index]
        child = links[row, LINK]
        sizes[row] = 1 if child == 0 else sizes[child] + sizes[child + 1]
    return sizes

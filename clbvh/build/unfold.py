"""A finished tree becomes one that can be rearranged: every triangle a leaf of its own, boxes in `simd` rows.

Row 1 is the root, row 0 is unused, and siblings stand at 2k and 2k + 1: ``row ^ 1`` is a row's sibling, and one
parent serves both. The two spare lanes of a row are integers: `LINK`, the row of the first child, 0 for a leaf, and
`PRIM`, the leaf's triangle.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..layout import NODE_COUNT, NODE_FIRST, NODE_MAX
from ..simd import empty_box, half_area, load_row, store_row, unite
from .metadata import NEGATED_MAX
from .options import MAX_DEPTH, MAX_LEAF_SIZE

LINK = 3
PRIM = 7
ROOT = 1


@njit(cache=True, nogil=True)
def unfold(nodes, node_ints, prim_ids, records, rows, links, parents):  # type: ignore[no-untyped-def]
    """Write the rows of a tree whose leaves are cut down to single triangles.

    Parameters
    ----------
    nodes, node_ints : (N, 8) float32 and int32, the same memory
        Rows of `layout.NODE`.
    prim_ids : (n,) int32
    records : (n, 8) float32
        Of all triangles, see `metadata`.
    rows, links : (2n, 8) float32 and int32, the same memory, written
    parents : (n,) int32, written
        ``parents[row >> 1]`` is the parent of a row; 0 for the root.
    """
    order = np.empty((3, MAX_LEAF_SIZE), np.int32)
    right_costs = np.empty(MAX_LEAF_SIZE, np.float64)
    waiting = np.empty((MAX_DEPTH + 1, 2), np.int32)
    waiting[0, 0], waiting[0, 1] = 0, ROOT
    waiting_count = 1
    parents[0] = 0
    next_pair = 2
    while waiting_count > 0:
        waiting_count -= 1
        source, row = waiting[waiting_count, 0], waiting[waiting_count, 1]
        first, count = node_ints[source, NODE_FIRST], node_ints[source, NODE_COUNT]
        if count > 0:
            prims = prim_ids[first : first + count].copy()
            next_pair = _cut_leaf(prims, records, row, next_pair, order, right_costs, rows, links, parents)
            continue
        for axis in range(3):
            rows[row, axis] = nodes[source, axis]
            rows[row, NEGATED_MAX + axis] = np.float32(0.0) - nodes[source, NODE_MAX + axis]
        links[row, LINK], links[row, PRIM] = next_pair, 0
        parents[next_pair >> 1] = row
        waiting[waiting_count, 0], waiting[waiting_count, 1] = first + 1, next_pair + 1
        waiting[waiting_count + 1, 0], waiting[waiting_count + 1, 1] = first, next_pair
        waiting_count += 2
        next_pair += 2


@njit(cache=True, nogil=True)
def _cut_leaf(prims, records, row, next_pair, order, right_costs, rows, links, parents):  # type: ignore[no-untyped-def]
    """Cut a leaf until every triangle stands alone, always at the cheapest place; return the next free pair."""
    # Ranges of `prims` that wait, and their rows.
    waiting = [(0, len(prims), row)]
    while len(waiting) > 0:
        begin, end, row = waiting.pop()
        if end - begin == 1:
            store_row(rows, row, load_row(records, prims[begin]))
            links[row, LINK], links[row, PRIM] = 0, prims[begin]
            continue
        box = empty_box()
        for place in range(begin, end):
            box = unite(load_row(records, prims[place]), box)
        store_row(rows, row, box)
        middle = begin + sweep(prims[begin:end], records, order, right_costs)
        links[row, LINK], links[row, PRIM] = next_pair, 0
        parents[next_pair >> 1] = row
        waiting.append((middle, end, next_pair + 1))
        waiting.append((begin, middle, next_pair))
        next_pair += 2
    return next_pair


@njit(cache=True, nogil=True)
def sweep(prims, records, order, right_costs):  # type: ignore[no-untyped-def]
    """Sort a few triangles so that the cheapest cut of all is between two neighbours; return how many stand before it.

    Parameters
    ----------
    prims : (k,) int32, sorted
        At least two.
    records : (n, 8) float32
    order : (3, >= k) int32, scratch
    right_costs : (>= k,) float64, scratch

    Notes
    -----
    O(k^2): for leaves. Equal costs go to the more even cut, then to the lowest axis.
    """
    count = len(prims)
    best_cost, best_axis, best_left, best_evenness = np.inf, 0, count // 2, -1
    for axis in range(3):
        # By the doubled centroid; equal ones keep their order.
        for place in range(count):
            prim = prims[place]
            key = records[prim, axis] - records[prim, NEGATED_MAX + axis]
            hole = place
            while hole > 0:
                before = order[axis, hole - 1]
                if not records[before, axis] - records[before, NEGATED_MAX + axis] > key:
                    break
                order[axis, hole] = before
                hole -= 1
            order[axis, hole] = prim

        box = empty_box()
        for place in range(count - 1, 0, -1):
            box = unite(load_row(records, order[axis, place]), box)
            right_costs[place] = half_area(box) * (count - place)
        box = empty_box()
        for place in range(1, count):
            box = unite(load_row(records, order[axis, place - 1]), box)
            cost = half_area(box) * place + right_costs[place]
            evenness = min(place, count - place)
            if cost < best_cost or (cost == best_cost and evenness > best_evenness):
                best_cost, best_axis, best_left, best_evenness = cost, axis, place, evenness
    for place in range(count):
        prims[place] = order[best_axis, place]
    return best_left

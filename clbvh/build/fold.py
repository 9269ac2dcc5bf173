"""A rearranged tree becomes a finished one: the cheapest leaves, and rows in depth-first order.

The opposite of `unfold`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..layout import NODE_COUNT, NODE_FIRST, NODE_MAX
from ..simd import half_area, load_row
from .metadata import NEGATED_MAX
from .options import MAX_DEPTH, MAX_LEAF_SIZE
from .unfold import LINK, PRIM, ROOT


@njit(cache=True, nogil=True)
def choose_leaves(rows, links, leaf_size, traversal_cost, order, is_leaf):  # type: ignore[no-untyped-def]
    """Mark which rows are leaves in the tree of the lowest SAH cost, and return how deep that tree is.

    Parameters
    ----------
    rows, links : (2n, 8) float32 and int32, the same memory
        See `unfold`.
    leaf_size, traversal_cost
        See `BuildOptions`.
    order : (k,) int32
        All rows, parents before their children.
    is_leaf : (2n,) bool, written
        What it says about rows below a leaf is of no use.

    Notes
    -----
    Exact: whether a subtree had better be a leaf does not depend on the rest of the tree. Equal costs make a leaf.
    """
    costs = np.empty(len(rows), np.float64)
    sizes = np.empty(len(rows), np.int32)
    heights = np.empty(len(rows), np.int32)
    for index in range(len(order) - 1, -1, -1):
        row = order[index]
        area = half_area(load_row(rows, row))
        child = links[row, LINK]
        if child == 0:
            costs[row], sizes[row], heights[row], is_leaf[row] = area, 1, 0, True
            continue
        size = sizes[child] + sizes[child + 1]
        split_cost = traversal_cost * area + costs[child] + costs[child + 1]
        sizes[row] = size
        is_leaf[row] = size <= leaf_size and size * area <= split_cost
        costs[row] = size * area if is_leaf[row] else split_cost
        heights[row] = 0 if is_leaf[row] else 1 + max(heights[child], heights[child + 1])
    return heights[ROOT]


@njit(cache=True, nogil=True)
def fold(rows, links, is_leaf, nodes, node_ints, prim_ids):  # type: ignore[no-untyped-def]
    """Write the nodes in depth-first order and return how many there are.

    Parameters
    ----------
    rows, links : (2n, 8) float32 and int32, the same memory
    is_leaf : (2n,) bool
        Of a tree that is at most `MAX_DEPTH` deep.
    nodes, node_ints : (2n, 8) float32 and int32, the same memory, written
        Rows of `layout.NODE`.
    prim_ids : (n,) int32, written
    """
    waiting = np.empty((MAX_DEPTH + 1, 2), np.int32)
    waiting_below = np.empty(MAX_LEAF_SIZE, np.int32)
    waiting[0, 0], waiting[0, 1] = ROOT, 0
    waiting_count = 1
    next_row, next_place = 1, 0
    while waiting_count > 0:
        waiting_count -= 1
        source, row = waiting[waiting_count, 0], waiting[waiting_count, 1]
        for axis in range(3):
            nodes[row, axis] = rows[source, axis]
            nodes[row, NODE_MAX + axis] = np.float32(0.0) - rows[source, NEGATED_MAX + axis]
        if is_leaf[source]:
            begin = next_place
            next_place = _list_prims(links, source, prim_ids, begin, waiting_below)
            node_ints[row, NODE_FIRST], node_ints[row, NODE_COUNT] = begin, next_place - begin
            continue
        child = links[source, LINK]
        node_ints[row, NODE_FIRST], node_ints[row, NODE_COUNT] = next_row, 0
        waiting[waiting_count, 0], waiting[waiting_count, 1] = child + 1, next_row + 1
        waiting[waiting_count + 1, 0], waiting[waiting_count + 1, 1] = child, next_row
        waiting_count += 2
        next_row += 2
    return next_row


@njit(cache=True, nogil=True)
def _list_prims(links, top, prim_ids, begin, waiting):  # type: ignore[no-untyped-def]
    """Write the triangles below a row from place `begin` on, ascending, and return the place behind them."""
    end = begin
    waiting[0] = top
    waiting_count = 1
    while waiting_count > 0:
        waiting_count -= 1
        row = waiting[waiting_count]
        child = links[row, LINK]
        if child != 0:
            waiting[waiting_count], waiting[waiting_count + 1] = child + 1, child
            waiting_count += 2
            continue
        prim = links[row, PRIM]
        hole = end
        while hole > begin and prim_ids[hole - 1] > prim:
            prim_ids[hole] = prim_ids[hole - 1]
            hole -= 1
        prim_ids[hole] = prim
        end += 1
    return end

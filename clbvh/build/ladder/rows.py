"""A range of primitives becomes rows of the flat tree at once, and the rows move to their final places."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...layout import NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from ..options import MAX_DEPTH
from .divide import bound_range, divide, list_prims


@njit(cache=True, nogil=True)
def build_rows(prims, begin, end, depth, rule, prim_ids, scratch, nodes, node_ints, root):  # type: ignore[no-untyped-def]
    """Build the subtree over prim_ids[begin:end] in depth-first order, without gaps.

    Parameters
    ----------
    prims : Recomputed or Cached
    depth : int
        Depth of the subtree's root in the whole tree.
    rule : Rule
    prim_ids : (n,) int32, changed in place
    scratch : Scratch
    nodes, node_ints : (2n, 8) float32 and int32, the same memory, rows of `layout.NODE`, written
    root : int
        The row of the subtree's root; its descendants follow.

    Returns
    -------
    int
        Number of rows used. Interior nodes name their children by these rows.
    """
    # Nodes that wait for their turn, at most one per level because the left child is taken at once: row, range, depth.
    waiting = np.empty((MAX_DEPTH + 1, 4), np.int64)
    waiting_count = 0
    row, next_row = root, root + 1
    while True:
        bound_range(prims, prim_ids, begin, end, scratch.bounds)
        for axis in range(3):
            nodes[row, axis] = scratch.bounds[0, axis]
            nodes[row, NODE_MAX + axis] = scratch.bounds[0, axis + 3]

        # A leaf; then the right child that waits.
        if end - begin <= rule.leaf_size:
            node_ints[row, NODE_FIRST] = begin
            node_ints[row, NODE_COUNT] = end - begin
            list_prims(prim_ids, begin, end, begin, prim_ids)
            if waiting_count == 0:
                return next_row - root
            waiting_count -= 1
            row, begin, end, depth = (
                waiting[waiting_count, 0], waiting[waiting_count, 1],
                waiting[waiting_count, 2], waiting[waiting_count, 3],
            )  # fmt: skip
            continue

        # Two halves with a row each; the left one is next.
        middle = divide(prims, prim_ids, begin, end, depth, rule, scratch)
        node_ints[row, NODE_FIRST] = next_row
        node_ints[row, NODE_COUNT] = 0
        depth += 1
        waiting[waiting_count, 0] = next_row + 1
        waiting[waiting_count, 1] = middle
        waiting[waiting_count, 2] = end
        waiting[waiting_count, 3] = depth
        waiting_count += 1
        row, end = next_row, middle
        next_row += 2


@njit(cache=True, nogil=True)
def place_rows(scratch, source, row_count, nodes, root_row, first_row):  # type: ignore[no-untyped-def]
    """Copy a subtree from the scratch rows to its final ones, and point its nodes at each other again.

    Parameters
    ----------
    scratch : (2n, 8) int32
        Rows of `layout.NODE`.
    source, row_count, root_row, first_row : int
        Its rows, the first one being its root; the final row of its root, and of the first of its descendants.
    nodes : (N, 8) int32, written
    """
    shift = np.int32(first_row - (source + 1))
    for index in range(row_count):
        row = root_row if index == 0 else first_row + index - 1
        for lane in range(NODE_LANES):
            nodes[row, lane] = scratch[source + index, lane]
        if nodes[row, NODE_COUNT] == 0:
            nodes[row, NODE_FIRST] += shift

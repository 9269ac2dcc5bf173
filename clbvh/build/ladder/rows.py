"""A range of primitives becomes rows of the flat tree at once."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...layout import NODE_COUNT, NODE_FIRST, NODE_MAX
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

"""A range of primitives becomes a tree of linked nodes; a tree of linked nodes becomes rows."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...layout import NODE_COUNT, NODE_FIRST, NODE_MAX
from ..options import MAX_DEPTH
from .divide import bound_range, divide, list_prims
from .heap import COUNT, FIRST, LEFT, RIGHT, allocate_node, base_of, box_of, words_of
from .prims import BOX


@njit(cache=True, nogil=True)
def build_linked(prims, ids, begin, end, first, depth, rule, prim_ids, scratch, heap):  # type: ignore[no-untyped-def]
    """Build the subtree over ids[begin:end] from new nodes.

    Parameters
    ----------
    prims : Recomputed or Cached
    ids : (m,) int32, changed in place
        The index array of all nodes, or this node's own list.
    first : int
        Where its primitives lie in `prim_ids`.
    depth : int
        Depth of the subtree's root in the whole tree.
    rule : Rule
    prim_ids : (n,) int32, written by the leaves
        May be `ids`.
    scratch : Scratch
    heap : Heap

    Returns
    -------
    int
        Reference to the subtree's root.
    """
    base = base_of(heap)
    # Nodes that wait for their turn, at most one per level because the left child is taken at once: range, place in
    # prim_ids, depth, parent. A loop, because numba loads recursive functions wrongly from its cache (its issue 6061).
    waiting = np.empty((MAX_DEPTH + 1, 5), np.int64)
    waiting_lists = [ids]
    waiting_count = 0
    root = parent = np.int64(-1)
    child = LEFT
    while True:
        # A new node, and the parent's reference to it.
        reference = allocate_node(heap)
        if parent < 0:
            root = reference
        else:
            words_of(base + parent)[child] = reference
        bound_range(prims, ids, begin, end, scratch.bounds)
        words, box = words_of(base + reference), box_of(base + reference)
        for lane in range(BOX):
            box[lane] = scratch.bounds[0, lane]

        # A leaf; then the right child that waits.
        if end - begin <= rule.leaf_size:
            words[FIRST] = first
            words[COUNT] = end - begin
            list_prims(ids, begin, end, first, prim_ids)
            if waiting_count == 0:
                return root
            waiting_count -= 1
            begin, end, first, depth, parent = (
                waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2],
                waiting[waiting_count, 3], waiting[waiting_count, 4],
            )  # fmt: skip
            child = RIGHT
            if rule.copies:
                ids = waiting_lists.pop()
            continue

        # Two halves; the left one is next.
        middle = divide(prims, ids, begin, end, depth, rule, scratch)
        words[COUNT] = 0
        depth += 1
        waiting[waiting_count, 0] = middle
        waiting[waiting_count, 1] = end
        waiting[waiting_count, 2] = first + middle - begin
        waiting[waiting_count, 3] = depth
        waiting[waiting_count, 4] = reference
        if rule.copies:
            waiting[waiting_count, 0] = 0
            waiting[waiting_count, 1] = end - middle
            waiting_lists.append(ids[middle:end].copy())
            ids = ids[begin:middle].copy()
            begin, end = 0, middle - begin
        else:
            end = middle
        waiting_count += 1
        parent, child = reference, LEFT


@njit(cache=True, nogil=True)
def flatten(base, root, nodes, node_ints, root_row, first_row):  # type: ignore[no-untyped-def]
    """Write a linked tree as rows in depth-first order.

    Parameters
    ----------
    base, root : int
        What turns a reference into an address; the reference to the root.
    nodes, node_ints : (N, 8) float32 and int32, the same memory, rows of `layout.NODE`, written
    root_row, first_row : int
        The row of the root, and of the first of its descendants.
    """
    # Nodes that wait for their turn: at most one per level, because the left child is taken at once.
    waiting = np.empty((MAX_DEPTH + 1, 2), np.int64)
    waiting_count = 0
    reference, row, next_row = root, root_row, first_row
    while True:
        words, box = words_of(base + reference), box_of(base + reference)
        for axis in range(3):
            nodes[row, axis] = box[axis]
            nodes[row, NODE_MAX + axis] = box[axis + 3]
        node_ints[row, NODE_COUNT] = words[COUNT]
        if words[COUNT] == 0:
            node_ints[row, NODE_FIRST] = next_row
            waiting[waiting_count, 0] = words[RIGHT]
            waiting[waiting_count, 1] = next_row + 1
            waiting_count += 1
            reference, row = words[LEFT], next_row
            next_row += 2
        else:
            node_ints[row, NODE_FIRST] = words[FIRST]
            if waiting_count == 0:
                return
            waiting_count -= 1
            reference, row = waiting[waiting_count, 0], waiting[waiting_count, 1]

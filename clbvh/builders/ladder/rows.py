"""A range of primitives becomes nodes of the flat tree at once."""

from __future__ import annotations

import numpy as np

from ...structs import NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ..options import MAX_DEPTH
from .divide import bound_range, divide, list_prims


@compiled
def build_rows(prims, task, rule, prim_ids, scratch, nodes):
    """Build a subtree in depth-first order, without gaps, from index 2 * task.begin on.

    A tree over n primitives has at most 2n - 1 nodes, so ranges that do not overlap own nodes that do not overlap.

    Parameters
    ----------
    prims : Recomputed or Cached
    task : Task
    rule : Rule
    prim_ids : (n,) int32, changed in place
    scratch : Scratch
    nodes : (2n, 8) float32, rows of `structs.NODE`, written

    Returns
    -------
    int
        Number of nodes. Interior nodes name their children by indices of `nodes`.
    """
    node_ints = nodes.view(np.int32)
    begin, end, depth = task
    root = 2 * begin
    # Right children: index, begin, end, depth. At most one per level, because the left child is next.
    stack = np.empty((MAX_DEPTH + 1, 4), np.int64)
    stack_size = 0
    index, next_index = root, root + 1
    while True:
        bound_range(prims, prim_ids, begin, end, scratch.bounds)
        for axis in range(3):
            nodes[index, axis] = scratch.bounds[0, axis]
            nodes[index, NODE_MAX + axis] = scratch.bounds[0, axis + 3]

        # A leaf; then the right child on top of the stack.
        if end - begin <= rule.leaf_size:
            node_ints[index, NODE_FIRST] = begin
            node_ints[index, NODE_COUNT] = end - begin
            list_prims(prim_ids, begin, end, begin, prim_ids)
            if stack_size == 0:
                return next_index - root
            stack_size -= 1
            index, begin, end, depth = (
                stack[stack_size, 0], stack[stack_size, 1],
                stack[stack_size, 2], stack[stack_size, 3],
            )  # fmt: skip
            continue

        # An interior node; its right child goes on the stack, the left one is next.
        middle = divide(prims, prim_ids, begin, end, depth, rule, scratch)
        node_ints[index, NODE_FIRST] = next_index
        node_ints[index, NODE_COUNT] = 0
        depth += 1
        stack[stack_size, 0] = next_index + 1
        stack[stack_size, 1] = middle
        stack[stack_size, 2] = end
        stack[stack_size, 3] = depth
        stack_size += 1
        index, end = next_index, middle
        next_index += 2

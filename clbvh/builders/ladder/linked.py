"""A range of primitives becomes a tree of linked nodes; a tree of linked nodes becomes flat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ..options import MAX_DEPTH
from .divide import bound_range, divide, list_prims
from .heap import COUNT, FIRST, LEFT, RIGHT, allocate_node, base_of, box_of, words_of
from .prims import BOX


class LinkedTask(NamedTuple):
    """A range of primitives that becomes a linked subtree.

    Attributes
    ----------
    ids : (m,) int32
        The index array of all nodes, or this node's own list.
    begin, end : int
        Its range of `ids`.
    first : int
        Where its primitives begin in `prim_ids`.
    depth : int
        Depth of the subtree's root in the whole tree.
    """

    ids: NDArray[np.int32]
    begin: int
    end: int
    first: int
    depth: int


@compiled
def build_linked(prims, task, rule, prim_ids, scratch, heap):
    """Build a subtree from new nodes.

    Parameters
    ----------
    prims : Recomputed or Cached
    task : LinkedTask
        Its `ids` are changed in place.
    rule : Rule
    prim_ids : (n,) int32, written by the leaves
        May be `task.ids`.
    scratch : Scratch
    heap : Heap

    Returns
    -------
    int
        Reference to the subtree's root.
    """
    base = base_of(heap)
    ids, begin, end, first, depth = task
    # Right children: begin, end, first, depth, parent. At most one per level, because the left child is next. A loop,
    # because numba loads recursive functions wrongly from its cache (its issue 6061).
    stack = np.empty((MAX_DEPTH + 1, 5), np.int64)
    stack_lists = [ids]
    stack_size = 0
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

        # A leaf; then the right child on top of the stack.
        if end - begin <= rule.leaf_size:
            words[FIRST] = first
            words[COUNT] = end - begin
            list_prims(ids, begin, end, first, prim_ids)
            if stack_size == 0:
                return root
            stack_size -= 1
            begin, end, first = stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2]
            depth, parent = stack[stack_size, 3], stack[stack_size, 4]
            child = RIGHT
            if rule.copies:
                ids = stack_lists.pop()
            continue

        # An interior node; its right child goes on the stack, the left one is next.
        middle = divide(prims, ids, begin, end, depth, rule, scratch)
        words[COUNT] = 0
        depth += 1
        stack[stack_size, 0] = middle
        stack[stack_size, 1] = end
        stack[stack_size, 2] = first + middle - begin
        stack[stack_size, 3] = depth
        stack[stack_size, 4] = reference
        if rule.copies:
            stack[stack_size, 0] = 0
            stack[stack_size, 1] = end - middle
            stack_lists.append(ids[middle:end].copy())
            ids = ids[begin:middle].copy()
            begin, end = 0, middle - begin
        else:
            end = middle
        stack_size += 1
        parent, child = reference, LEFT


@compiled
def flatten(base, root, placement, nodes):
    """Write a linked tree in depth-first order.

    Parameters
    ----------
    base, root : int
        The address to which references are relative, and the reference to the root.
    placement : Placement
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    """
    node_ints = nodes.view(np.int32)
    # Right children: reference and index. At most one per level, because the left child is next.
    stack = np.empty((MAX_DEPTH + 1, 2), np.int64)
    stack_size = 0
    reference = root
    index, next_index = placement
    while True:
        words, box = words_of(base + reference), box_of(base + reference)
        for axis in range(3):
            nodes[index, axis] = box[axis]
            nodes[index, NODE_MAX + axis] = box[axis + 3]
        node_ints[index, NODE_COUNT] = words[COUNT]
        if words[COUNT] == 0:
            node_ints[index, NODE_FIRST] = next_index
            stack[stack_size, 0] = words[RIGHT]
            stack[stack_size, 1] = next_index + 1
            stack_size += 1
            reference, index = words[LEFT], next_index
            next_index += 2
        else:
            node_ints[index, NODE_FIRST] = words[FIRST]
            if stack_size == 0:
                return
            stack_size -= 1
            reference, index = stack[stack_size, 0], stack[stack_size, 1]

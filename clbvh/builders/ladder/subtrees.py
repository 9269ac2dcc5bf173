"""A range of primitives becomes a subtree: of linked nodes, which are flattened later, or flat at once.

A linked node is a block of seven 8-byte words: six float32 of its box, two references to its children, and for a leaf
its range of primitives. Blocks come from one of two places: the process's own heap, one `malloc` each, or an array that
all workers share, where one atomic counter says which block is the next. A reference is the node's address, less the
address of that array.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ...structs import NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ...support.loop_functions import add_atomically
from ..options import MAX_DEPTH
from .divide import BOX, bound_range, divide, list_prims

# Words of a node; the box lies in the first three.
LEFT = 3
RIGHT = 4
FIRST = 5
COUNT = 6  # 0 in an interior node
WORDS = 7
NODE_BYTES = 8 * WORDS

# The counter has a cache line of its own, so that its cost can be measured alone.
COUNTER_WORDS = 8


class Heap(NamedTuple):
    """Where nodes come from.

    Attributes
    ----------
    blocks : (k, 7) int64
        The shared array; when it is empty, nodes come from the process's own heap.
    counter : (8,) int64
        Word 0: number of nodes allocated.
    """

    blocks: NDArray[np.int64]
    counter: NDArray[np.int64]


def make_private_heap() -> Heap:
    """Return the process's own heap, with a count of its own."""
    return Heap(np.empty((0, WORDS), np.int64), np.zeros(COUNTER_WORDS, np.int64))


@intrinsic
def _allocate_block(typing_context, size):
    """Return the address of a new block of memory, 0 if there is none."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ptrtoint(context.nrt.allocate(builder, arguments[0]), context.get_value_type(types.intp))

    return types.intp(types.intp), generate


@intrinsic
def _free_block(typing_context, address):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        context.nrt.free(builder, builder.inttoptr(arguments[0], ir.IntType(8).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.intp), generate


@intrinsic
def _pointer_to(typing_context, address):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.intp), generate


@compiled
def base_of(heap):
    """Return the address to which references are relative."""
    return np.int64(heap.blocks.ctypes.data) if len(heap.blocks) > 0 else np.int64(0)


@compiled
def words_of(address):
    """Return the node at an address as (7,) int64."""
    return carray(_pointer_to(address), (WORDS,), np.int64)


@compiled
def box_of(address):
    """Return the box of the node at an address as (6,) float32."""
    return carray(_pointer_to(address), (2 * LEFT,), np.float32)


@compiled
def allocate_node(heap):
    """Return a reference to a new node."""
    if len(heap.blocks) > 0:
        return add_atomically(heap.counter, 1) * NODE_BYTES
    address = _allocate_block(NODE_BYTES)
    if address == 0:
        raise MemoryError("no memory for another node")
    heap.counter[0] += 1
    return address


@compiled
def free_nodes(root):
    """Free a node of the process's own heap, given its address, and all below it."""
    stack = np.empty(MAX_DEPTH + 2, np.int64)
    stack[0] = root
    stack_size = 1
    while stack_size > 0:
        stack_size -= 1
        address = stack[stack_size]
        words = words_of(address)
        if words[COUNT] == 0:
            stack[stack_size] = words[RIGHT]
            stack[stack_size + 1] = words[LEFT]
            stack_size += 2
        _free_block(address)


@compiled
def build_linked(prims, ids, task, rule, prim_ids, scratch, heap):
    """Build a subtree from new nodes.

    Parameters
    ----------
    prims : Recomputed or Cached
    ids : (m,) int32, changed in place
        `prim_ids`, or in variants that copy the root's own list.
    task : Task
    rule : Rule
    prim_ids : (n,) int32, written by the leaves
    scratch : Scratch
    heap : Heap

    Returns
    -------
    int
        Reference to the subtree's root.
    """
    base = base_of(heap)
    first, end, depth = task
    begin = 0 if rule.copies else first
    end += begin - first
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

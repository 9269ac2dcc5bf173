"""Nodes that are allocated one at a time and found by reference.

A node is a block of seven 8-byte words: six float32 of its box, two references to its children, and for a leaf its
range of primitives. Blocks come from one of two places: the process's own heap, one `malloc` each, or an array that
all worker processes share, where one atomic counter says which block is the next. A reference is the node's
address, less the address of that array.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import carray
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ...support.compiled import compiled
from ...support.loop_functions import add_atomically
from ..options import MAX_DEPTH

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

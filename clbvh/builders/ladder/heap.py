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
from numba import carray, njit
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ..options import MAX_DEPTH

# Words of a node; the box lies in the first three.
LEFT = 3
RIGHT = 4
FIRST = 5
COUNT = 6  # 0 in an interior node
WORDS = 7
NODE_BYTES = 8 * WORDS

# The counter has a cache line for itself, so that what it costs is its own cost.
COUNTER_WORDS = 8


class Heap(NamedTuple):
    """Where nodes come from.

    Attributes
    ----------
    blocks : (k, 7) int64
        The shared array; without rows, nodes come from the process's own heap.
    counter : (8,) int64
        Word 0: how many nodes were allocated.
    """

    blocks: NDArray[np.int64]
    counter: NDArray[np.int64]


def make_private_heap() -> Heap:
    """Return the process's own heap, with a count of its own."""
    return Heap(np.empty((0, WORDS), np.int64), np.zeros(COUNTER_WORDS, np.int64))


@intrinsic
def add_atomically(typing_context, counter, amount):  # type: ignore[no-untyped-def]
    """Add to word 0 of an int64 array, undivided by any other thread or process; return what was there."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", word, arguments[1], "seq_cst")

    return types.int64(counter, types.int64), generate


@intrinsic
def _allocate_block(typing_context, size):  # type: ignore[no-untyped-def]
    """Return the address of a new block of memory, 0 if there is none."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ptrtoint(context.nrt.allocate(builder, arguments[0]), context.get_value_type(types.intp))

    return types.intp(types.intp), generate


@intrinsic
def _free_block(typing_context, address):  # type: ignore[no-untyped-def]
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        context.nrt.free(builder, builder.inttoptr(arguments[0], ir.IntType(8).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.intp), generate


@intrinsic
def _pointer_to(typing_context, address):  # type: ignore[no-untyped-def]
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.intp), generate


@njit(cache=True, nogil=True)
def base_of(heap):  # type: ignore[no-untyped-def]
    """Return what turns a reference into an address."""
    return np.int64(heap.blocks.ctypes.data) if len(heap.blocks) > 0 else np.int64(0)


@njit(cache=True, nogil=True)
def words_of(address):  # type: ignore[no-untyped-def]
    """Return the node at an address as (7,) int64."""
    return carray(_pointer_to(address), (WORDS,), np.int64)


@njit(cache=True, nogil=True)
def box_of(address):  # type: ignore[no-untyped-def]
    """Return the box of the node at an address as (6,) float32."""
    return carray(_pointer_to(address), (2 * LEFT,), np.float32)


@njit(cache=True, nogil=True)
def allocate_node(heap):  # type: ignore[no-untyped-def]
    """Return a reference to a new node."""
    if len(heap.blocks) > 0:
        return add_atomically(heap.counter, 1) * NODE_BYTES
    address = _allocate_block(NODE_BYTES)
    if address == 0:
        raise MemoryError("no memory for another node")
    heap.counter[0] += 1
    return address


@njit(cache=True, nogil=True)
def free_nodes(root):  # type: ignore[no-untyped-def]
    """Free a node of the process's own heap, given its address, and all below it."""
    waiting = np.empty(MAX_DEPTH + 2, np.int64)
    waiting[0] = root
    waiting_count = 1
    while waiting_count > 0:
        waiting_count -= 1
        address = waiting[waiting_count]
        words = words_of(address)
        if words[COUNT] == 0:
            waiting[waiting_count] = words[RIGHT]
            waiting[waiting_count + 1] = words[LEFT]
            waiting_count += 2
        _free_block(address)

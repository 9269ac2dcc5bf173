"""What a worker does for the coordinator of a rung: one function per step.

The arrays, for n primitives; which of them there are depends on the rung:

    vertices   (V, 3) float32   the mesh
    faces      (n, 3) int32     the mesh
    aabbs      (n, 6) float32   box of each primitive, from `cached` on
    centroids  (n, 3) float32   and its centroid
    prim_ids   (n,) int32       the index array; result
    blocks     (2n, 7) int64    the nodes that one atomic counter hands out
    counter    (8,) int64       that counter
    rows       (2n, 8) float32  rows of `layout.NODE`, where subtrees are built
    nodes      (N, 8) float32   result, rows of `layout.NODE`

A range is (begin, end, depth). With it comes a list of its primitives where each node has its own, and None where
the index array holds them.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .divide import Rule, bound_range, divide, make_scratch
from .heap import COUNT, LEFT, NODE_BYTES, RIGHT, Heap, allocate_node, free_nodes, make_private_heap
from .linked import build_linked, flatten
from .prims import BOX, Cached, Recomputed, fill_cache
from .rows import build_rows, place_rows

Arrays = Mapping[str, NDArray[Any]]
Ids = NDArray[np.int32] | None


class _Held(threading.local):
    """Linked trees of this process that wait to become rows; each thread that builds has its own."""

    def __init__(self) -> None:
        self.roots: dict[int, int] = {}  # the root's address, by the place of the first primitive


_held = _Held()


class Halves(NamedTuple):
    """What became of a range of the top.

    Attributes
    ----------
    box : (6,) float32
    middle : int
        Where the right half begins.
    lists : pair of (m,) int32, or pair of None
        The halves' own lists.
    block : int
        The node's number, where an atomic counter numbers nodes; -1 elsewhere.
    """

    box: NDArray[np.float32]
    middle: int
    lists: tuple[Ids, Ids]
    block: int


class Placement(NamedTuple):
    """Where a finished subtree goes: its primitives begin at `begin`, and it has `row_count` nodes."""

    begin: int
    row_count: int
    root_row: int
    first_row: int


def cache_slice(arrays: Arrays, begin: int, end: int) -> None:
    """Fill the boxes and centroids of a slice of the primitives."""
    fill_cache(arrays["vertices"], arrays["faces"], begin, end, arrays["aabbs"], arrays["centroids"])


def divide_range(arrays: Arrays, begin: int, end: int, depth: int, ids: Ids, rule: Rule) -> Halves:
    """Divide a range of the top, all on one worker: here the report's builder is serial."""
    prims, scratch = _prims(arrays), make_scratch(end - begin)
    index, first, last = (arrays["prim_ids"], begin, end) if ids is None else (ids, 0, len(ids))
    bound_range(prims, index, first, last, scratch.bounds)
    box = scratch.bounds[0].copy()
    middle = divide(prims, index, first, last, depth, rule, scratch)
    lists = (None, None) if ids is None else (ids[:middle], ids[middle:])
    block = allocate_node(_shared_heap(arrays)) // NODE_BYTES if "blocks" in arrays else -1
    return Halves(box, begin + middle - first, lists, block)


def build_and_hold(arrays: Arrays, begin: int, end: int, depth: int, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree in this process's own heap and keep it there; return its number of nodes."""
    heap = make_private_heap()
    _held.roots[begin] = _build_linked(arrays, begin, end, depth, ids, rule, heap)
    return int(heap.counter[0])


def build_counted(arrays: Arrays, begin: int, end: int, depth: int, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree from the nodes that one counter hands out to all workers; return the root's number."""
    return _build_linked(arrays, begin, end, depth, ids, rule, _shared_heap(arrays)) // NODE_BYTES


def build_flat(arrays: Arrays, begin: int, end: int, depth: int, ids: Ids, rule: Rule) -> int:
    """Build a subtree in rows from 2 * begin on; return its number of nodes.

    A tree over n primitives has at most 2n - 1 nodes, so ranges that do not overlap own rows that do not overlap.
    """
    rows, scratch = arrays["rows"], make_scratch(end - begin)
    return build_rows(
        _prims(arrays), begin, end, depth, rule, arrays["prim_ids"], scratch, rows, rows.view(np.int32), 2 * begin
    )


def flatten_held(arrays: Arrays, placements: Sequence[Placement]) -> int:
    """Write those subtrees that this process holds as rows; return how many there are."""
    nodes = arrays["nodes"]
    mine = [placement for placement in placements if placement.begin in _held.roots]
    for begin, _, root_row, first_row in mine:
        flatten(0, _held.roots[begin], nodes, nodes.view(np.int32), root_row, first_row)
    return len(mine)


def free_held(arrays: Arrays) -> None:
    """Free all linked trees that wait, those of an interrupted build included."""
    while _held.roots:
        free_nodes(_held.roots.popitem()[1])


def link_counted(arrays: Arrays, top: Sequence[tuple[int, NDArray[np.float32], Sequence[int]]]) -> int:
    """Write the top's nodes (number, box, children's numbers) to their blocks; return how many nodes there are."""
    blocks = arrays["blocks"]
    boxes = blocks.view(np.float32)
    for block, box, children in top:
        boxes[block, :BOX] = box
        blocks[block, LEFT], blocks[block, RIGHT] = (child * NODE_BYTES for child in children)
        blocks[block, COUNT] = 0
    return int(arrays["counter"][0])


def flatten_counted(arrays: Arrays, root: int) -> None:
    """Write the whole linked tree in the shared blocks as rows."""
    blocks, nodes = arrays["blocks"], arrays["nodes"]
    flatten(blocks.ctypes.data, root * NODE_BYTES, nodes, nodes.view(np.int32), 0, 1)


def place_subtrees(arrays: Arrays, placements: Sequence[Placement]) -> None:
    """Copy subtrees to their final rows."""
    rows, nodes = arrays["rows"].view(np.int32), arrays["nodes"].view(np.int32)
    for begin, row_count, root_row, first_row in placements:
        place_rows(rows, 2 * begin, row_count, nodes, root_row, first_row)


def _prims(arrays: Arrays) -> Cached | Recomputed:
    if "aabbs" in arrays:
        return Cached(arrays["aabbs"], arrays["centroids"])
    return Recomputed(arrays["vertices"], arrays["faces"])


def _shared_heap(arrays: Arrays) -> Heap:
    return Heap(arrays["blocks"], arrays["counter"])


def _build_linked(arrays: Arrays, begin: int, end: int, depth: int, ids: Ids, rule: Rule, heap: Heap) -> int:
    prim_ids, scratch = arrays["prim_ids"], make_scratch(end - begin)
    index, first, last = (prim_ids, begin, end) if ids is None else (ids, 0, len(ids))
    return build_linked(_prims(arrays), index, first, last, begin, depth, rule, prim_ids, scratch, heap)

"""The steps of a variant that run in a worker: all work on primitives and nodes, so that only ranges are sent.

The arrays, for n primitives; which of them there are depends on the variant:

    vertices   (V, 3) float32   corners of the primitives
    faces      (n, 3) int32     the three of each primitive
    aabbs      (n, 6) float32   box of each primitive, from `cached` on
    centroids  (n, 3) float32   and its centroid
    prim_ids   (n,) int32       the index array; result
    blocks     (2n, 7) int64    the nodes that one atomic counter hands out
    counter    (8,) int64       that counter
    rows       (2n, 8) float32  rows of `structs.NODE`, where subtrees are built
    nodes      (N, 8) float32   result, rows of `structs.NODE`

With a range comes its own list of primitives in variants whose nodes have one, and None where the index array has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..executor import Arrays
from ..invariants import WHOLE_TREE, Placement, place_subtree
from .divide import BOX, Cached, Recomputed, Rule, Task, bound_range, divide, fill_cache, make_scratch
from .subtrees import (
    COUNT,
    LEFT,
    NODE_BYTES,
    RIGHT,
    Heap,
    allocate_node,
    build_linked,
    build_rows,
    flatten,
    free_nodes,
    make_private_heap,
)

Ids = NDArray[np.int32] | None


# Linked trees of this process that are not flattened yet: (address of the build's index array, first primitive) ->
# address of the root.
_held: dict[tuple[int, int], int] = {}


class Halves(NamedTuple):
    """The result of dividing a range of the top.

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


class Finished(NamedTuple):
    """A finished subtree: its first primitive, its number of nodes, and its place in the tree."""

    begin: int
    node_count: int
    placement: Placement


def cache_slice(arrays: Arrays, begin: int, end: int) -> None:
    """Fill the boxes and centroids of a slice of the primitives."""
    fill_cache(arrays["vertices"], arrays["faces"], begin, end, arrays["aabbs"], arrays["centroids"])


def divide_range(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> Halves:
    """Divide a range of the top, all on one worker: here the report's builder is serial."""
    begin, end, depth = task
    prims, scratch = _prims(arrays), make_scratch(end - begin)
    index, first, last = (arrays["prim_ids"], begin, end) if ids is None else (ids, 0, len(ids))
    bound_range(prims, index, first, last, scratch.bounds)
    box = scratch.bounds[0].copy()
    middle = divide(prims, index, first, last, depth, rule, scratch)
    lists = (None, None) if ids is None else (ids[:middle], ids[middle:])
    block = allocate_node(_shared_heap(arrays)) // NODE_BYTES if "blocks" in arrays else -1
    return Halves(box, begin + middle - first, lists, block)


def build_and_hold(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree in this process's own heap and keep it there; return its number of nodes."""
    heap = make_private_heap()
    _held[_build_of(arrays), task.begin] = _build_linked(arrays, task, ids, rule, heap)
    return int(heap.counter[0])


def build_counted(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree from the nodes that one counter hands out to all workers; return the root's number."""
    return _build_linked(arrays, task, ids, rule, _shared_heap(arrays)) // NODE_BYTES


def build_flat(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a subtree in the rows of its range; return its number of nodes."""
    scratch = make_scratch(task.end - task.begin)
    return build_rows(_prims(arrays), task, rule, arrays["prim_ids"], scratch, arrays["rows"])


def flatten_held(arrays: Arrays, subtrees: Sequence[Finished]) -> None:
    """Flatten those subtrees that this process holds."""
    build = _build_of(arrays)
    for subtree in subtrees:
        if (build, subtree.begin) in _held:
            flatten(0, _held[build, subtree.begin], subtree.placement, arrays["nodes"])


def free_held(arrays: Arrays) -> None:
    """Free all linked trees of this build that this process holds."""
    build = _build_of(arrays)
    for key in [key for key in _held.copy() if key[0] == build]:
        free_nodes(_held.pop(key))


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
    """Flatten the whole linked tree in the shared blocks."""
    flatten(arrays["blocks"].ctypes.data, root * NODE_BYTES, WHOLE_TREE, arrays["nodes"])


def place_subtrees(arrays: Arrays, subtrees: Sequence[Finished]) -> None:
    """Copy subtrees to their indices in the whole tree."""
    for begin, node_count, placement in subtrees:
        place_subtree(arrays["rows"], 2 * begin, node_count, 0, placement, arrays["nodes"])


def _build_of(arrays: Arrays) -> int:
    """Return the number of a build in this process."""
    return int(arrays["prim_ids"].ctypes.data)


def _prims(arrays: Arrays) -> Cached | Recomputed:
    if "aabbs" in arrays:
        return Cached(arrays["aabbs"], arrays["centroids"])
    return Recomputed(arrays["vertices"], arrays["faces"])


def _shared_heap(arrays: Arrays) -> Heap:
    return Heap(arrays["blocks"], arrays["counter"])


def _build_linked(arrays: Arrays, task: Task, ids: Ids, rule: Rule, heap: Heap) -> int:
    prim_ids, scratch = arrays["prim_ids"], make_scratch(task.end - task.begin)
    return build_linked(_prims(arrays), prim_ids if ids is None else ids, task, rule, prim_ids, scratch, heap)

"""The steps of a variant that run in a worker: all work on primitives and nodes, so that only ranges are sent.

The arrays, for n primitives; which of them there are depends on the variant:

    vertices   (V, 3) float32     corners of the primitives
    faces      (n, 3) int32       the three of each primitive
    boxes      (n, 8) float32     box of each primitive, a row of `structs.BOX`, from `cached` on
    centroids  (n, 3) float32     and its centroid
    prim_ids   (n,) int32         the index array; result
    blocks     (2n,) LINKED_NODE  the nodes that one atomic counter hands out
    counter    (8,) int64         that counter
    rows       (2n, 8) float32    rows of `structs.NODE`, where subtrees are built
    nodes      (N, 8) float32     result, rows of `structs.NODE`

With a range comes its own list of primitives in variants whose nodes have one, and None where the index array has them.
The loops are those of cl/host/ladder/build.cl.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...structs import BOX_LANES, NODE_COUNT, NODE_FIRST
from ..executor import Arrays
from ..invariants import WHOLE_TREE, Placement

_LOOPS = Loops("ladder/build")

Ids = NDArray[np.int32] | None

# A linked node: references to its children, or for a leaf its range of primitives; a count of 0 in an interior node. A
# reference is the node's address, less that of `blocks`.
LINKED_NODE = np.dtype([("box", "f4", BOX_LANES), ("left", "i8"), ("right", "i8"), ("first", "i4"), ("count", "i4")])

# The counter has a cache line of its own, so that its cost can be measured alone.
COUNTER_WORDS = 8

# Linked trees of this process that are not flattened yet: (address of the build's index array, first primitive) ->
# address of the root.
_held: dict[tuple[int, int], int] = {}


class Rule(NamedTuple):
    """How a variant divides a node, as loops take it.

    Attributes
    ----------
    how : int
        SORT, SELECT or BINS.
    bins : int
        Number of bins, for BINS.
    leaf_size : int
        A range of at most this many primitives becomes a leaf.
    copies : bool
        Whether each node gets a list of primitives of its own.
    """

    how: int
    bins: int
    leaf_size: int
    copies: bool


class Task(NamedTuple):
    """A range of primitives of the whole tree, and the depth of its node."""

    begin: int
    end: int
    depth: int


class Halves(NamedTuple):
    """The result of dividing a range of the top.

    Attributes
    ----------
    box : (8,) float32, a row of `structs.BOX`
    middle : int
        Where the right half begins.
    lists : pair of (m,) int32, or pair of None
        The halves' own lists.
    reference : int
        To the node, where an atomic counter hands out nodes; -1 elsewhere.
    """

    box: NDArray[np.float32]
    middle: int
    lists: tuple[Ids, Ids]
    reference: int


class Finished(NamedTuple):
    """A finished subtree: its first primitive, its number of nodes, and its place in the tree."""

    begin: int
    node_count: int
    placement: Placement


def cache_slice(arrays: Arrays, begin: int, end: int) -> None:
    """Fill the boxes and centroids of a slice of the primitives."""
    _LOOPS.cache_slice(arrays["vertices"], arrays["faces"], begin, end, arrays["boxes"], arrays["centroids"])


def divide_range(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> Halves:
    """Divide a range of the top, all on one worker: here the report's builder is serial."""
    own, box = _range_of(arrays, task, ids), np.empty(BOX_LANES, np.float32)
    left = _LOOPS.divide_range(*_prims(arrays), *rule, own, task.depth, _scratch(task), box)
    lists = (None, None) if ids is None else (ids[:left], ids[left:])
    return Halves(box, task.begin + left, lists, int(allocate_blocks(arrays, 1)[0]) if "blocks" in arrays else -1)


def allocate_blocks(arrays: Arrays, count: int) -> NDArray[np.int64]:
    """Return references to new nodes, by the counter."""
    references = np.empty(count, np.int64)
    _LOOPS.allocate_blocks(_words(arrays["blocks"]), arrays["counter"], references)
    return references


def build_and_hold(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree in this process's own heap and keep it there; return its number of nodes."""
    count = np.zeros(1, np.int64)
    _held[_build_of(arrays), task.begin] = _build_linked(arrays, task, ids, rule, None, count)
    return int(count[0])


def build_counted(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a linked subtree from the nodes that one counter hands out to all workers; return its root's reference."""
    return _build_linked(arrays, task, ids, rule, _words(arrays["blocks"]), arrays["counter"])


def build_flat(arrays: Arrays, task: Task, ids: Ids, rule: Rule) -> int:
    """Build a subtree in the rows of its range; return its number of nodes."""
    begin, _, depth = task
    return int(
        _LOOPS.build_flat_subtree(
            *_prims(arrays), *rule, arrays["prim_ids"], begin, depth, _scratch(task), arrays["rows"]
        )
    )


def flatten_held(arrays: Arrays, subtrees: Sequence[Finished]) -> None:
    """Flatten those subtrees that this process holds."""
    build = _build_of(arrays)
    for subtree in subtrees:
        if (build, subtree.begin) in _held:
            _LOOPS.flatten_subtree(None, _held[build, subtree.begin], arrays["nodes"], *subtree.placement)


def free_held(arrays: Arrays) -> None:
    """Free all linked trees of this build that this process holds."""
    build = _build_of(arrays)
    for key in [key for key in _held.copy() if key[0] == build]:
        _LOOPS.free_subtree(_held.pop(key))


def link_counted(arrays: Arrays, top: Sequence[tuple[int, NDArray[np.float32], Sequence[int]]]) -> int:
    """Write the top's nodes (reference, box, those of the children); return how many nodes there are in all."""
    for reference, box, children in top:
        arrays["blocks"][reference // LINKED_NODE.itemsize] = box, *children, 0, 0
    return int(arrays["counter"][0])


def flatten_counted(arrays: Arrays, root: int) -> None:
    """Flatten the whole linked tree in the shared blocks."""
    _LOOPS.flatten_subtree(_words(arrays["blocks"]), root, arrays["nodes"], *WHOLE_TREE)


def place_subtrees(arrays: Arrays, subtrees: Sequence[Finished]) -> None:
    """Copy subtrees to their indices in the whole tree."""
    for first, node_count, (root, below) in subtrees:
        rows = arrays["rows"][2 * first : 2 * first + node_count]
        # Below the root, which has its sibling beside it, all descendants follow each other.
        for part, index in ((rows[:1], root), (rows[1:], below)):
            placed = arrays["nodes"][index : index + len(part)]
            placed[:] = part
            lanes = placed.view(np.int32)
            lanes[lanes[:, NODE_COUNT] == 0, NODE_FIRST] += below - (2 * first + 1)


def _build_of(arrays: Arrays) -> int:
    """Return the number of a build in this process."""
    return int(arrays["prim_ids"].ctypes.data)


def _prims(arrays: Arrays) -> list[NDArray[Any] | None]:
    """Return the mesh, or its metadata, as loops take them."""
    return [arrays.get(name) for name in ("vertices", "faces", "boxes", "centroids")]


def _range_of(arrays: Arrays, task: Task, ids: Ids) -> NDArray[np.int32]:
    return arrays["prim_ids"][task.begin : task.end] if ids is None else ids


def _scratch(task: Task) -> NDArray[np.int32]:
    return np.empty(task.end - task.begin, np.int32)


def _words(blocks: NDArray[np.void]) -> NDArray[np.int64]:
    return blocks.view(np.int64)


def _build_linked(
    arrays: Arrays, task: Task, ids: Ids, rule: Rule, blocks: NDArray[np.int64] | None, counter: NDArray[np.int64]
) -> int:
    own, prim_ids = _range_of(arrays, task, ids), arrays["prim_ids"]
    root = _LOOPS.build_linked_subtree(
        *_prims(arrays), *rule, own, task.begin, task.depth, prim_ids, _scratch(task), blocks, counter
    )
    if root < 0:
        raise MemoryError("no memory for another node")
    return int(root)

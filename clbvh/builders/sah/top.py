"""The top of the tree, by all threads at once.

A range too large for one worker is split level by level: every thread bins its slice of each large node, the bins are
united and the splits picked, every thread moves its slices. The report's builder is serial here; after Wald, "On fast
construction of SAH-based bounding volume hierarchies" (2007), it need not be.

These are threads of the calling process, as many as there are workers: the steps are short and many, and a message to
another process takes longer than a thread takes to wake.

The splits and the order of the primitive references are those of `subtree.build_subtree`, so the tree does not depend
on where the top ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...structs import BOX_LANES, BOX_TALLY
from ...support.ranges import cut_range
from ..halving import middle_of, needs_halving
from ..prim_refs import Bounds
from ..workers.executor import Executor
from .binned_split import Split, bin_count_for, fill_bins, find_split, unite_sides
from .partition import Slice, bound_halves, partition
from .ranges import Range

# As plain Python: for a few nodes that is fast enough, and loading a compiled function takes 20 ms.
_bin_count_for = bin_count_for.py_func
_needs_halving = needs_halving.py_func
_middle_of = middle_of.py_func

# Two rows of `boxes`: left and right.
_Boxes = NDArray[np.float32]

# A slice of a node: the node, begin and end of the slice, its bin count.
_BinTask = tuple[Range, int, int, int]
# A slice of a node, and the node's split.
_PartitionTask = tuple[Range, Slice, Split]


@dataclass(frozen=True)
class _SplitNode:
    """A node with its split, the boxes of both sides, and the number of primitives in each bin, slice by slice."""

    node: Range
    split: Split
    boxes: _Boxes
    slice_tallies: list[NDArray[np.int32]]


def split_top(executor: Executor, root: Range, threshold: int, bins: int) -> None:
    """Split the root, and all ranges below it, until none has more than `threshold` primitives."""
    level = [root]
    while level := [node for node in level if len(node) > threshold]:
        # Find the splits; nodes that no plane splits are halved.
        slice_bins = _bin_level(executor, level, bins)
        split_nodes = [_choose_split(node, node_bins) for node, node_bins in zip(level, slice_bins, strict=True)]
        for node, split_node in zip(level, split_nodes, strict=True):
            if split_node is None:
                _halve(node, executor.arrays["prim_refs"])
        # Move the primitive references of all others.
        _partition_level(executor, [split_node for split_node in split_nodes if split_node is not None])
        level = [child for node in level for child in node.children]


def _bin_level(executor: Executor, level: list[Range], bins: int) -> list[list[NDArray[np.float32]]]:
    """Return the bins of each node, slice by slice."""
    bin_counts = [_bin_count_for(len(node), bins) for node in level]
    tasks: list[list[_BinTask]] = [[] for _ in range(executor.workers)]
    for node, bin_count in zip(level, bin_counts, strict=True):
        for task, (begin, end) in zip(tasks, cut_range(node.begin, node.end, executor.workers), strict=True):
            task.append((node, begin, end, bin_count))
    by_thread = executor.threads.run(_bin_slices, [(executor.arrays["prim_refs"], task) for task in tasks])
    return [[slices[number] for slices in by_thread] for number in range(len(level))]


def _choose_split(node: Range, slice_bins: list[NDArray[np.float32]]) -> _SplitNode | None:
    """Unite the bins of a node's slices and find its split; None where no plane splits it."""
    slice_tallies = [part.view(np.int32)[:, BOX_TALLY] for part in slice_bins]
    bins = np.minimum.reduce(slice_bins)
    bins.view(np.int32)[:, BOX_TALLY] = np.add.reduce(slice_tallies)
    split = Split(*find_split(bins, len(bins) // 3, np.empty(len(bins), np.float64)))
    if _needs_halving(len(node), node.depth) or not split.cost < np.inf:
        return None
    boxes = np.empty((2, BOX_LANES), np.float32)
    unite_sides(bins, split, boxes)
    return _SplitNode(node, split, boxes, slice_tallies)


def _partition_level(executor: Executor, split_nodes: list[_SplitNode]) -> None:
    """Move the primitive references of all nodes to their sides, and give the nodes their children."""
    tasks: list[list[_PartitionTask]] = [[] for _ in range(executor.workers)]
    for split_node in split_nodes:
        for task, part in zip(tasks, _cut_slices(split_node), strict=True):
            task.append((split_node.node, part, split_node.split))
    by_thread = executor.threads.run(_partition_slices, [(executor.arrays["prim_refs"], task) for task in tasks])
    for number, split_node in enumerate(split_nodes):
        node = split_node.node
        centroid_boxes = np.minimum.reduce([slices[number] for slices in by_thread])
        middle = node.begin + split_node.split.left_count
        node.children = _make_children(node, middle, 1 - node.buffer, split_node.boxes, centroid_boxes)


def _cut_slices(split_node: _SplitNode) -> list[Slice]:
    """Cut a node into slices; the bins of each say how many of its primitive references go left."""
    node, split = split_node.node, split_node.split
    left, right = node.begin, node.begin + split.left_count
    first_bin = split.axis * split.bin_count
    slices = []
    parts = cut_range(node.begin, node.end, len(split_node.slice_tallies))
    for (begin, end), tallies in zip(parts, split_node.slice_tallies, strict=True):
        slices.append(Slice(begin, end, left, right))
        left_count = int(tallies[first_bin : first_bin + split.last_left_bin + 1].sum())
        left += left_count
        right += end - begin - left_count
    return slices


def _bin_slices(prim_refs: NDArray[np.float32], tasks: Sequence[_BinTask]) -> list[NDArray[np.float32]]:
    """Return the bins of one slice of each node."""
    results = []
    for node, begin, end, bin_count in tasks:
        bins = np.empty((3 * bin_count, BOX_LANES), np.float32)
        fill_bins(prim_refs[node.buffer], begin, end, node.bounds, bin_count, bins)
        results.append(bins)
    return results


def _partition_slices(prim_refs: NDArray[np.float32], tasks: Sequence[_PartitionTask]) -> list[_Boxes]:
    """Move one slice of each node to its sides; return the boxes of the centroids on both sides."""
    results = []
    for node, part, split in tasks:
        centroid_boxes = np.empty((2, BOX_LANES), np.float32)
        partition(prim_refs[node.buffer], prim_refs[1 - node.buffer], part, node.bounds, split, centroid_boxes)
        results.append(centroid_boxes)
    return results


def _halve(node: Range, prim_refs: NDArray[np.float32]) -> None:
    """Cut a node that no plane splits in the middle of its range; nothing moves."""
    middle = _middle_of(node.begin, node.end)
    boxes, centroid_boxes = np.empty((2, BOX_LANES), np.float32), np.empty((2, BOX_LANES), np.float32)
    bound_halves(prim_refs[node.buffer], node.begin, middle, node.end, boxes, centroid_boxes)
    node.children = _make_children(node, middle, node.buffer, boxes, centroid_boxes)


def _make_children(node: Range, middle: int, buffer: int, boxes: _Boxes, centroid_boxes: _Boxes) -> tuple[Range, Range]:
    bounds: list[Bounds] = [np.stack([boxes[side], centroid_boxes[side]]) for side in range(2)]
    return (
        Range(node.begin, middle, buffer, node.depth + 1, bounds[0]),
        Range(middle, node.end, buffer, node.depth + 1, bounds[1]),
    )

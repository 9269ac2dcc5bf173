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

import numpy as np
from numpy.typing import NDArray

from ...structs import BOX_LANES
from ..executor import Executor
from ..halving import middle_of
from ..prim_refs import Bounds
from .level import LEFT_COUNT, Level, bin_slices, choose_splits, make_level, partition_slices
from .partition import bound_halves
from .ranges import Range

# As plain Python: for a few nodes that is fast enough, and loading a compiled function takes 20 ms.
_middle_of = middle_of.py_func

# Bounds the memory for bins: 1.5 KiB for each node and thread. A level has more nodes only where a tiny task threshold
# is asked for.
_NODES_AT_ONCE = 512


def split_top(executor: Executor, root: Range, threshold: int, bins: int) -> None:
    """Split the root, and all ranges below it, until none has more than `threshold` primitives."""
    depth, nodes = root.depth, [root]
    while nodes := [node for node in nodes if len(node) > threshold]:
        for first in range(0, len(nodes), _NODES_AT_ONCE):
            some = nodes[first : first + _NODES_AT_ONCE]
            _make_children(some, _split_nodes(executor, some, depth, bins), executor.arrays["prim_refs"])
        nodes = [child for node in nodes for child in node.children]
        depth += 1


def _split_nodes(executor: Executor, nodes: list[Range], depth: int, bins: int) -> Level:
    """Find the splits of nodes of one level, and move their primitive references to their sides."""
    prim_refs, threads = executor.arrays["prim_refs"], executor.threads
    ranges = np.array([(node.begin, node.end, node.buffer) for node in nodes], np.int64)
    level = make_level(ranges, np.stack([node.bounds for node in nodes]), executor.workers, bins)
    threads.run(bin_slices, [(prim_refs, level, number, bins) for number in range(executor.workers)])
    choose_splits(level, depth, bins)
    threads.run(partition_slices, [(prim_refs, level, number) for number in range(executor.workers)])
    return level


def _make_children(nodes: list[Range], level: Level, prim_refs: NDArray[np.float32]) -> None:
    """Give the nodes of a level their children; those that no plane splits are halved."""
    # (k, 2, 2, 8): of each node and side the box of the primitives and that of their centroids.
    bounds = np.stack([level.boxes, np.minimum.reduce(level.centroid_boxes, axis=1)], axis=2)
    for node, left_count, child_bounds in zip(nodes, level.splits[:, LEFT_COUNT].tolist(), bounds, strict=True):
        if left_count == 0:
            node.children = _halve(node, prim_refs)
        else:
            node.children = _cut(node, node.begin + left_count, 1 - node.buffer, child_bounds)


def _halve(node: Range, prim_refs: NDArray[np.float32]) -> tuple[Range, Range]:
    """Cut a node that no plane splits in the middle of its range; nothing moves."""
    middle = _middle_of(node.begin, node.end)
    boxes, centroid_boxes = np.empty((2, BOX_LANES), np.float32), np.empty((2, BOX_LANES), np.float32)
    bound_halves(prim_refs[node.buffer], node.begin, middle, node.end, boxes, centroid_boxes)
    return _cut(node, middle, node.buffer, np.stack([boxes, centroid_boxes], axis=1))


def _cut(node: Range, middle: int, buffer: int, bounds: Bounds) -> tuple[Range, Range]:
    """Return the children of a node, whose bounds are (2, 2, 8)."""
    return (
        Range(node.begin, middle, buffer, node.depth + 1, bounds[0]),
        Range(middle, node.end, buffer, node.depth + 1, bounds[1]),
    )

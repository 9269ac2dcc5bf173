"""The top of the tree, by all threads at once.

A range too large for one worker is split level by level: every thread bins its slice of each large node, the bins are
united and the splits picked, every thread moves its slices. The report's builder is serial here; after Wald, "On fast
construction of SAH-based bounding volume hierarchies" (2007), it need not be.

These are threads of the calling process, as many as there are workers: the steps are short and many, and a message to
another process takes longer than a thread takes to wake.

The splits and the order of the primitive references are those of a subtree's loop, so the tree does not depend on where
the top ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...device.host.loops import Loops
from ...structs import BOX_LANES
from ..executor import Executor
from ..invariants import TopNode
from ..prim_refs import Bounds


@dataclass
class Range(TopNode):
    """A range of primitive references.

    Attributes
    ----------
    buffer : int
        Which of the two buffers holds it.
    bounds : (2, 8) float32
    """

    buffer: int
    bounds: Bounds


_TOP = Loops("builders/top")

# Bounds the memory for bins: 1.5 KiB for each node and thread. A level has more nodes only where a tiny task threshold
# is asked for.
_NODES_AT_ONCE = 512


def split_top(executor: Executor, root: Range, threshold: int, bins: int) -> None:
    """Split the root, and all ranges below it, until none has more than `threshold` primitives.

    A range that no plane splits stays as it is, whatever its size: one worker halves it.
    """
    depth, nodes = root.depth, [root]
    while nodes := [node for node in nodes if len(node) > threshold]:
        for first in range(0, len(nodes), _NODES_AT_ONCE):
            some = nodes[first : first + _NODES_AT_ONCE]
            _split_nodes(executor, some, depth, bins)
        nodes = [child for node in nodes for child in node.children]
        depth += 1


def _split_nodes(executor: Executor, nodes: list[Range], depth: int, bins: int) -> None:
    """Find the splits of nodes of one level, move their primitive references, and give those their children.

    Nodes are in arrays, so that a level takes two calls for each thread and one between them: with calls for each node
    and slice, Python took as long as the threads from about 200 nodes on.
    """
    prim_refs, threads, slices = executor.arrays["prim_refs"], executor.threads, executor.workers
    count = prim_refs.shape[1]
    ranges = np.array([(node.begin, node.end, node.buffer) for node in nodes], np.int64)
    bounds = np.stack([node.bounds for node in nodes])

    # All threads bin their slices of each node. Of the last axis a node uses as many rows as it has bins.
    slice_bins = np.empty((len(nodes), slices, 3 * bins, BOX_LANES), np.float32)
    binned = [(count, prim_refs, ranges, bounds, slices, number, bins, slice_bins) for number in range(slices)]
    threads.run(_TOP.bin_slices, binned)

    # The splits: axis, last bin on the left, left count and bins along the axis; the left count is 0 where no plane
    # splits a node. Then the boxes of both sides, and the index in the other buffer of each slice's first reference on
    # either side.
    splits, boxes = np.empty((len(nodes), 4), np.int32), np.empty((len(nodes), 2, BOX_LANES), np.float32)
    targets = np.empty((len(nodes), slices, 2), np.int64)
    _TOP.choose_splits(ranges, slices, bins, slice_bins, depth, splits, boxes, targets)

    # All threads move their slices, and find the boxes of the centroids on both sides of them.
    centroids = np.empty((len(nodes), slices, 2, BOX_LANES), np.float32)
    moved = [(count, prim_refs, ranges, bounds, splits, slices, number, targets, centroids) for number in range(slices)]
    threads.run(_TOP.partition_slices, moved)

    # (k, 2, 2, 8): of each node and side the box of the primitives and that of their centroids.
    child_bounds = np.stack([boxes, np.minimum.reduce(centroids, axis=1)], axis=2)
    for node, left_count, (left, right) in zip(nodes, splits[:, 2].tolist(), child_bounds, strict=True):
        if left_count > 0:
            middle, below, buffer = node.begin + left_count, node.depth + 1, 1 - node.buffer
            node.box = node.bounds[0]
            node.children = (
                Range(node.begin, middle, below, buffer, left),
                Range(middle, node.end, below, buffer, right),
            )

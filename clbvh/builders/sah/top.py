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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import load_box, store_box, tally_of, unite
from ...structs import BOX_LANES, BOX_TALLY
from ...support.compiled import compiled
from ..executor import Executor
from ..invariants import TopNode, needs_halving
from ..prim_refs import Bounds
from .split import Slice, Split, bin_count_for, fill_bins, find_split, make_bins, partition, unite_sides


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


# Columns of `ranges`.
BEGIN, END, BUFFER = range(3)

# Columns of `splits`.
AXIS, LAST_LEFT_BIN, LEFT_COUNT, BIN_COUNT = range(4)


class Level(NamedTuple):
    """Nodes of one level of the top, in arrays, so that a level takes two calls for each thread and one between them.

    With calls for each node and slice, Python took as long as the threads from about 200 nodes on. For k nodes that are
    cut into w slices each, one for each thread:

        ranges          (k, 3) int64            begin, end and buffer of each node
        bounds          (k, 2, 8) float32       its bounds
        bins            (k, w, 3 b, 8) float32  bins of its slices; of the last axis a node uses as many rows as it has
        splits          (k, 4) int64            its split; a left count of 0 where no plane splits it
        boxes           (k, 2, 8) float32       boxes of both sides of the split
        targets         (k, w, 2) int64         index in the other buffer of each slice's first reference on either side
        centroid_boxes  (k, w, 2, 8) float32    boxes of the centroids on both sides of each slice
    """

    ranges: NDArray[np.int64]
    bounds: NDArray[np.float32]
    bins: NDArray[np.float32]
    splits: NDArray[np.int64]
    boxes: NDArray[np.float32]
    targets: NDArray[np.int64]
    centroid_boxes: NDArray[np.float32]


def make_level(ranges: NDArray[np.int64], bounds: NDArray[np.float32], slice_count: int, bins: int) -> Level:
    """Return the arrays of a level whose nodes are cut into slices."""
    count = len(ranges)
    return Level(
        ranges,
        bounds,
        np.empty((count, slice_count, 3 * bins, BOX_LANES), np.float32),
        np.zeros((count, 4), np.int64),
        np.empty((count, 2, BOX_LANES), np.float32),
        np.empty((count, slice_count, 2), np.int64),
        np.empty((count, slice_count, 2, BOX_LANES), np.float32),
    )


@compiled
def slice_begin(level, node, number):
    """Return where a slice of a node begins, and the one before it ends."""
    begin, end = level.ranges[node, BEGIN], level.ranges[node, END]
    return begin + (end - begin) * number // level.targets.shape[1]


@compiled
def bin_slices(prim_refs, level, number, most_bins):
    """Fill the bins of one slice of each node.

    Parameters
    ----------
    prim_refs : (2, n, 8) float32
    level : Level
        Written: bins.
    number : int
        Of the slice.
    most_bins : int
        Bins along an axis; a small node has fewer.
    """
    for node in range(len(level.ranges)):
        bin_count = bin_count_for(level.ranges[node, END] - level.ranges[node, BEGIN], most_bins)
        begin, end = slice_begin(level, node, number), slice_begin(level, node, number + 1)
        refs = prim_refs[level.ranges[node, BUFFER]]
        fill_bins(refs, begin, end, level.bounds[node], bin_count, level.bins[node, number])


@compiled
def choose_splits(level, depth, most_bins):
    """Unite the bins of each node's slices, find its split, and where each slice's primitive references go.

    Parameters
    ----------
    level : Level
        Written: splits, boxes, targets.
    depth : int
        Of the level in the tree.
    most_bins : int
    """
    slice_count = level.targets.shape[1]
    united, right_costs = make_bins(most_bins), np.empty(3 * most_bins, np.float64)
    for node in range(len(level.ranges)):
        begin, prim_count = level.ranges[node, BEGIN], level.ranges[node, END] - level.ranges[node, BEGIN]
        bin_count = bin_count_for(prim_count, most_bins)
        unite_bins(level.bins[node], 3 * bin_count, united)
        split = find_split(united, bin_count, right_costs)
        if needs_halving(prim_count, depth) or not split.cost < np.inf:
            level.splits[node, LEFT_COUNT] = 0
            continue
        unite_sides(united, split, level.boxes[node])
        level.splits[node, AXIS], level.splits[node, LAST_LEFT_BIN] = split.axis, split.last_left_bin
        level.splits[node, LEFT_COUNT], level.splits[node, BIN_COUNT] = split.left_count, bin_count

        # The bins of a slice say how many of its primitive references go left.
        left, right = begin, begin + split.left_count
        first_bin = split.axis * bin_count
        for number in range(slice_count):
            level.targets[node, number, 0], level.targets[node, number, 1] = left, right
            left_count = 0
            for row in range(first_bin, first_bin + split.last_left_bin + 1):
                left_count += tally_of(load_box(level.bins[node, number], row))
            left += left_count
            right += slice_begin(level, node, number + 1) - slice_begin(level, node, number) - left_count


@compiled
def unite_bins(slice_bins, row_count, united):
    """Unite the bins of all slices of a node.

    Parameters
    ----------
    slice_bins : (w, >= row_count, 8) float32
    row_count : int
    united : (>= row_count, 8) float32, written
    """
    tallies = united.view(np.int32)
    for row in range(row_count):
        box = load_box(slice_bins[0], row)
        tally = tally_of(box)
        for number in range(1, len(slice_bins)):
            other = load_box(slice_bins[number], row)
            tally += tally_of(other)
            box = unite(other, box)
        store_box(united, row, box)
        tallies[row, BOX_TALLY] = tally


@compiled
def partition_slices(prim_refs, level, number):
    """Move one slice of each node that is split to its sides.

    Parameters
    ----------
    prim_refs : (2, n, 8) float32, written
    level : Level
        Written: centroid_boxes.
    number : int
        Of the slice.
    """
    for node in range(len(level.ranges)):
        axis, last_left_bin, left_count, bin_count = level.splits[node]
        if left_count == 0:
            continue
        buffer = level.ranges[node, BUFFER]
        part = Slice(
            slice_begin(level, node, number),
            slice_begin(level, node, number + 1),
            level.targets[node, number, 0],
            level.targets[node, number, 1],
        )
        split = Split(0.0, axis, last_left_bin, left_count, bin_count)
        boxes = level.centroid_boxes[node, number]
        partition(prim_refs[buffer], prim_refs[1 - buffer], part, level.bounds[node], split, boxes)


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
            _make_children(some, _split_nodes(executor, some, depth, bins))
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


def _make_children(nodes: list[Range], level: Level) -> None:
    """Give those nodes of a level that are split their children."""
    # (k, 2, 2, 8): of each node and side the box of the primitives and that of their centroids.
    bounds = np.stack([level.boxes, np.minimum.reduce(level.centroid_boxes, axis=1)], axis=2)
    for node, left_count, (left, right) in zip(nodes, level.splits[:, LEFT_COUNT].tolist(), bounds, strict=True):
        if left_count > 0:
            middle, depth, buffer = node.begin + left_count, node.depth + 1, 1 - node.buffer
            node.children = (
                Range(node.begin, middle, depth, buffer, left),
                Range(middle, node.end, depth, buffer, right),
            )

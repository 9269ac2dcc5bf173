"""The top of the tree, by all threads at once.

A range too large for one worker is split level by level: every thread bins its slice of each large node, the bins are
united and the splits picked, every thread moves its slices. The report's builder is serial here; after Wald, "On fast
construction of SAH-based bounding volume hierarchies" (2007), it need not be.

These are threads of the calling process, as many as there are workers: the steps are short and many, and a message to
another process takes longer than a thread takes to wake.

The splits and the order of the records are those of `subtree.build_subtree`, so the tree does not depend on where
the top ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simd import LANES, TALLY
from .crew import Crew
from .partition import bound_halves, partition
from .ranges import Boxes, Range, cut_slices
from .splits import bin_count_for, fill_bins, find_split, unite_sides
from .subtree import needs_halving

# A slice of a node: begin, end, buffer, the node's bounds, its bin count.
_BinTask = tuple[int, int, int, NDArray[np.float32], int]
# A slice of a node and the node's split: the same, then axis, last left bin, and where its records go.
_PartitionTask = tuple[int, int, int, NDArray[np.float32], int, int, int, int, int]

# As plain Python: for a few nodes that is fast enough, and loading a compiled function takes 20 ms.
_bin_count_for = bin_count_for.py_func
_needs_halving = needs_halving.py_func


@dataclass(frozen=True)
class Split:
    """A plane between two bins of one axis."""

    bin_count: int
    axis: int
    last_left_bin: int
    left_count: int


def split_top(crew: Crew, root: Range, threshold: int, bins: int) -> None:
    """Split the root, and all ranges below it, until none has more than `threshold` primitives."""
    level = [root]
    while level := [node for node in level if len(node) > threshold]:
        chosen = _choose_splits(crew, level, bins)
        planes = [(node, *pair) for node, pair in zip(level, chosen, strict=True) if pair is not None]
        _apply_splits(crew, planes)
        for node, pair in zip(level, chosen, strict=True):
            if pair is None:
                _halve(node, crew.arrays["records"])
        level = [child for node in level for child in node.children or ()]


def _choose_splits(crew: Crew, level: list[Range], bins: int) -> list[tuple[Split, Boxes, list[Any]] | None]:
    """Return each node's split, the boxes of its sides and the bin counts of its slices; None where no plane splits."""
    bin_counts = [_bin_count_for(len(node), bins) for node in level]
    tasks = [
        [
            (*cut_slices(node.begin, node.end, crew.workers)[number], node.buffer, node.bounds, bin_count)
            for node, bin_count in zip(level, bin_counts, strict=True)
        ]
        for number in range(crew.workers)
    ]
    slices = crew.threads.run(_bin_slices, [(crew.arrays["records"], task) for task in tasks])

    right_costs = np.empty(3 * bins, np.float64)
    chosen: list[tuple[Split, Boxes, list[Any]] | None] = []
    for index, (node, bin_count) in enumerate(zip(level, bin_counts, strict=True)):
        slice_bins = [part[index] for part in slices]
        slice_counts = [part.view(np.int32)[:, TALLY] for part in slice_bins]
        united = np.minimum.reduce(slice_bins)
        united.view(np.int32)[:, TALLY] = np.add.reduce(slice_counts)
        cost, axis, last_left_bin, left_count = find_split(united, bin_count, right_costs)
        if _needs_halving(len(node), node.depth) or not cost < np.inf:
            chosen.append(None)
            continue
        sides = np.empty((2, LANES), np.float32)
        unite_sides(united, bin_count, axis, last_left_bin, sides)
        chosen.append((Split(bin_count, axis, last_left_bin, left_count), sides, slice_counts))
    return chosen


def _apply_splits(crew: Crew, planes: list[tuple[Range, Split, Boxes, list[Any]]]) -> None:
    """Move the records of all nodes to their sides, and give the nodes their children."""
    tasks: list[list[_PartitionTask]] = [[] for _ in range(crew.workers)]
    for node, split, _, slice_counts in planes:
        left, right = node.begin, node.begin + split.left_count
        first_bin = split.axis * split.bin_count
        for number, (begin, end) in enumerate(cut_slices(node.begin, node.end, crew.workers)):
            plane = (split.bin_count, split.axis, split.last_left_bin)
            tasks[number].append((begin, end, node.buffer, node.bounds, *plane, left, right))
            # The slice's own bins say how many of its records go left.
            to_left = int(slice_counts[number][first_bin : first_bin + split.last_left_bin + 1].sum())
            left += to_left
            right += end - begin - to_left
    slices = crew.threads.run(_partition_slices, [(crew.arrays["records"], task) for task in tasks])

    for index, (node, split, sides, _) in enumerate(planes):
        centroid_bounds = np.minimum.reduce([part[index] for part in slices])
        middle = node.begin + split.left_count
        node.children = _make_children(node, middle, 1 - node.buffer, sides, centroid_bounds)


def _bin_slices(records: NDArray[np.float32], tasks: Sequence[_BinTask]) -> list[NDArray[np.float32]]:
    """Return the bins of one slice of each node."""
    results = []
    for begin, end, buffer, bounds, bin_count in tasks:
        bins = np.empty((3 * bin_count, LANES), np.float32)
        fill_bins(records[buffer], begin, end, bounds, 1, bin_count, bins)
        results.append(bins)
    return results


def _partition_slices(records: NDArray[np.float32], tasks: Sequence[_PartitionTask]) -> list[NDArray[np.float32]]:
    """Move one slice of each node to its sides; return the (2, 8) centroid bounds of both sides."""
    results = []
    for begin, end, buffer, bounds, bin_count, axis, last_left_bin, left, right in tasks:
        child_bounds = np.empty((2, LANES), np.float32)
        partition(
            records[buffer], begin, end, bounds, 1, bin_count, axis, last_left_bin,
            records[1 - buffer], left, right, child_bounds,
        )  # fmt: skip
        results.append(child_bounds)
    return results


def _halve(node: Range, records: NDArray[Any]) -> None:
    """Cut a node that no plane splits in the middle of its range; nothing moves."""
    middle = node.begin + len(node) // 2
    sides = np.empty((2, LANES), np.float32)
    centroid_bounds = np.empty((2, LANES), np.float32)
    bound_halves(records[node.buffer], node.begin, middle, node.end, sides, centroid_bounds)
    node.children = _make_children(node, middle, node.buffer, sides, centroid_bounds)


def _make_children(node: Range, middle: int, buffer: int, sides: Boxes, centroid_bounds: Boxes) -> tuple[Range, Range]:
    bounds = [np.stack([sides[side], centroid_bounds[side]]) for side in range(2)]
    return (
        Range(node.begin, middle, buffer, node.depth + 1, bounds[0]),
        Range(middle, node.end, buffer, node.depth + 1, bounds[1]),
    )

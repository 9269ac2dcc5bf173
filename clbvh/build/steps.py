"""What a worker does for the coordinator: one function per step of the build.

Each takes the arrays by name and plain numbers, and returns small arrays or numbers: everything large is written in
place. The arrays, for n primitives:

    records   (2, n, 8) float32   two buffers of `metadata` records; in the end they hold the nodes
    prim_ids  (n,) int32          result
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simd import LANES
from .options import MIN_BINS
from .partition import partition
from .splits import fill_bins
from .subtree import build_subtree

Arrays = Mapping[str, NDArray[Any]]

_WARM_UP_PRIMS = 4

# A slice of a node: begin, end, buffer, the node's bounds, its bin count.
BinTask = tuple[int, int, int, NDArray[np.float32], int]
# A slice of a node and the node's split: the same, then axis, last left bin, and where its records go.
PartitionTask = tuple[int, int, int, NDArray[np.float32], int, int, int, int, int]
# A range that becomes a subtree: begin, end, buffer, depth, bounds.
SubtreeTask = tuple[int, int, int, int, NDArray[np.float32]]


def bin_slices(arrays: Arrays, tasks: Sequence[BinTask]) -> list[NDArray[np.float32]]:
    """Return the bins of one slice of each node."""
    results = []
    for begin, end, buffer, bounds, bin_count in tasks:
        bins = np.empty((3 * bin_count, LANES), np.float32)
        fill_bins(arrays["records"][buffer], begin, end, bounds, 1, bin_count, bins)
        results.append(bins)
    return results


def partition_slices(arrays: Arrays, tasks: Sequence[PartitionTask]) -> list[NDArray[np.float32]]:
    """Move one slice of each node to its sides; return the (2, 8) centroid bounds of both sides."""
    records = arrays["records"]
    results = []
    for begin, end, buffer, bounds, bin_count, axis, last_left_bin, left, right in tasks:
        child_bounds = np.empty((2, LANES), np.float32)
        partition(
            records[buffer], begin, end, bounds, 1, bin_count, axis, last_left_bin,
            records[1 - buffer], left, right, child_bounds,
        )  # fmt: skip
        results.append(child_bounds)
    return results


def build_subtrees(
    arrays: Arrays, tasks: Sequence[SubtreeTask], bins: int, leaf_size: int, traversal_cost: float
) -> list[int]:
    """Build the subtrees of some ranges; return how many nodes each has."""
    records = arrays["records"]
    return [
        build_subtree(
            records, records.view(np.int32), begin, end, buffer, depth, bounds, bins, leaf_size, traversal_cost,
            arrays["prim_ids"],
        )
        for begin, end, buffer, depth, bounds in tasks
    ]  # fmt: skip


def warm_up() -> None:
    """Compile, or load from numba's cache, all that the steps above call."""
    arrays: dict[str, NDArray[Any]] = {
        "records": np.zeros((2, _WARM_UP_PRIMS, LANES), np.float32),
        "prim_ids": np.zeros(_WARM_UP_PRIMS, np.int32),
    }
    bounds = np.zeros((2, LANES), np.float32)
    bin_count = MIN_BINS
    bin_slices(arrays, [(0, _WARM_UP_PRIMS, 0, bounds, bin_count)])
    partition_slices(arrays, [(0, _WARM_UP_PRIMS, 0, bounds, bin_count, 0, 0, 0, 0)])
    build_subtrees(arrays, [(0, _WARM_UP_PRIMS, 0, 0, bounds)], bin_count, 1, 1.0)

"""What a worker does for the coordinator: one function per step of the build.

Each takes the attached arrays by name and plain numbers, and returns small arrays or numbers: everything large is
written in place. The arrays, for n primitives:

    vertices       (V, 3) float32      the mesh
    faces          (n, 3) int32        the mesh
    records        (2, n, 8) float32   two buffers of `metadata` records
    scratch_nodes  (2n, 8) float32     rows of `layout.NODE`, where subtrees are built
    prim_ids       (n,) int32          result
    nodes          (N, 8) float32      result, rows of `layout.NODE`
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compact import Placement, place_rows
from .metadata import fill_records
from .partition import partition
from .simd import LANES
from .splits import bin_count_for, fill_bins, make_bins
from .subtree import build_subtree

Arrays = Mapping[str, NDArray[Any]]

# A slice of a node: begin, end, buffer, the node's bounds, its bin count.
BinTask = tuple[int, int, int, NDArray[np.float32], int]
# A slice of a node and the node's split: the same, then axis, last left bin, and where its records go.
PartitionTask = tuple[int, int, int, NDArray[np.float32], int, int, int, int, int]
# A range that becomes a subtree: begin, end, buffer, depth, bounds.
SubtreeTask = tuple[int, int, int, int, NDArray[np.float32]]


def record_slice(arrays: Arrays, begin: int, end: int) -> NDArray[np.float32]:
    """Write the records of a slice of the primitives; return their (2, 8) bounds."""
    bounds = np.empty((2, LANES), np.float32)
    records = arrays["records"]
    fill_records(arrays["vertices"], arrays["faces"], begin, end, records[0], records.view(np.int32)[0], bounds)
    return bounds


def bin_slices(arrays: Arrays, tasks: Sequence[BinTask]) -> list[NDArray[np.float32]]:
    """Return the bins of one slice of each node."""
    results = []
    for begin, end, buffer, bounds, bin_count in tasks:
        bins = make_bins(bin_count)
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
    """Build the subtrees of some ranges; return how many rows each used."""
    records, nodes = arrays["records"], arrays["scratch_nodes"]
    return [
        build_subtree(
            records, records.view(np.int32), begin, end, buffer, depth, bounds, bins, leaf_size, traversal_cost,
            nodes, nodes.view(np.int32), arrays["prim_ids"],
        )
        for begin, end, buffer, depth, bounds in tasks
    ]  # fmt: skip


def place_subtrees(arrays: Arrays, placements: Sequence[Placement]) -> None:
    """Copy finished subtrees to their rows in the final tree."""
    scratch, nodes = arrays["scratch_nodes"].view(np.int32), arrays["nodes"].view(np.int32)
    for place in placements:
        place_rows(scratch, place.source, place.row_count, nodes, place.root_row, place.first_row)


def warm_up() -> None:
    """Compile, or load from numba's cache, all that the steps above call."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]], np.int32)
    count = len(faces)
    arrays: dict[str, NDArray[Any]] = {
        "vertices": vertices,
        "faces": faces,
        "records": np.zeros((2, count, LANES), np.float32),
        "scratch_nodes": np.zeros((2 * count, LANES), np.float32),
        "prim_ids": np.zeros(count, np.int32),
    }
    bounds = record_slice(arrays, 0, count)
    bin_count = bin_count_for(count, count)
    bin_slices(arrays, [(0, count, 0, bounds, bin_count)])
    partition_slices(arrays, [(0, count, 0, bounds, bin_count, 0, 0, 0, 0)])
    (row_count,) = build_subtrees(arrays, [(0, count, 0, 0, bounds)], bin_count, 1, 1.0)
    arrays["nodes"] = np.zeros((row_count, LANES), np.float32)
    place_subtrees(arrays, [Placement(0, row_count, 0, 1)])

"""What a worker does for the coordinator.

A step takes the arrays by name and plain numbers, and returns small arrays or numbers: everything large is written in
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
from .subtree import build_subtree

Arrays = Mapping[str, NDArray[Any]]

_WARM_UP_PRIMS = 4

# A range that becomes a subtree: begin, end, buffer, depth, bounds.
SubtreeTask = tuple[int, int, int, int, NDArray[np.float32]]


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
    """Compile, or load from numba's cache, all that the step above calls."""
    arrays: dict[str, NDArray[Any]] = {
        "records": np.zeros((2, _WARM_UP_PRIMS, LANES), np.float32),
        "prim_ids": np.zeros(_WARM_UP_PRIMS, np.int32),
    }
    bounds = np.zeros((2, LANES), np.float32)
    build_subtrees(arrays, [(0, _WARM_UP_PRIMS, 0, 0, bounds)], MIN_BINS, 1, 1.0)

"""What a worker does for the coordinator.

The arrays, for n primitives:

records    (2, n, 8) float32   as (2n, 8): `metadata` records in their buckets, then nodes, rows of `layout.NODE`
prim_ids   (n,) int32          primitives in the order of each bucket's leaves
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...simd import LANES
from .grow import grow_buckets

Arrays = Mapping[str, NDArray[Any]]


def grow_subtrees(
    arrays: Arrays, buckets: NDArray[np.int64], bins: int, leaf_size: int, traversal_cost: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Build the subtrees of some buckets; return their boxes, and how many rows each uses."""
    rows = arrays["records"].reshape(-1, LANES)
    boxes, row_counts = np.empty((len(buckets), LANES), np.float32), np.empty(len(buckets), np.int64)
    grow_buckets(
        rows, rows.view(np.int32), buckets, bins, leaf_size, traversal_cost, arrays["prim_ids"], boxes, row_counts
    )
    return boxes, row_counts


def warm_up(arrays: Arrays) -> None:
    """Load the compiled code into this process."""
    _grow_something()


@cache
def _grow_something() -> None:
    count = 2
    arrays: Arrays = {"records": np.zeros((2, count, LANES), np.float32), "prim_ids": np.zeros(count, np.int32)}
    grow_subtrees(arrays, np.array([[0, count]]), 2, 1, 1.0)

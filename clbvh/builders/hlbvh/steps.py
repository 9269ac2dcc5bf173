"""The steps of the fast build that run in a worker: it builds the subtrees of treelets, and nothing else.

The arrays, for n primitives:

    prim_refs  (2, n, 8) float32   as (2n, 8): the primitive references of each treelet, then its nodes
    prim_ids   (n,) int32          primitives in the order of each treelet's leaves
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...structs import BOX_LANES
from ..executor import Arrays
from ..sah.rule import Rule
from .grow import grow_treelets


def grow_subtrees(
    arrays: Arrays, treelets: NDArray[np.int64], rule: Rule
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Build the subtrees of some treelets, (k, 2); return their boxes, (k, 8), and how many nodes each has."""
    boxes, node_counts = np.empty((len(treelets), BOX_LANES), np.float32), np.empty(len(treelets), np.int64)
    slots = arrays["prim_refs"].reshape(-1, BOX_LANES)
    grow_treelets(slots, treelets, rule, arrays["prim_ids"], boxes, node_counts)
    return boxes, node_counts

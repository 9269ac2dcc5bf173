"""Walks over the rows of a flat tree that rely on its order: children stand behind their parent."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def measure_depth(first, count):  # type: ignore[no-untyped-def]
    """Return the number of edges from the root to the deepest leaf.

    Parameters
    ----------
    first, count : (N,) int32
        The fields of the nodes, in an order where each child's row is above its parent's.
    """
    depths = np.zeros(len(first), np.int32)
    deepest = 0
    for row in range(len(first)):
        if count[row] == 0:
            depths[first[row]] = depths[first[row] + 1] = depths[row] + 1
        deepest = max(deepest, depths[row])
    return deepest

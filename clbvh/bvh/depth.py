"""Walks over the rows of a flat tree that rely on its order: children stand behind their parent."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def find_depths(first, count):  # type: ignore[no-untyped-def]
    """Return the number of edges from the root to each node, (N,) int32.

    Parameters
    ----------
    first, count : (N,) int32
        The fields of the nodes, in an order where each child's row is above its parent's.
    """
    depths = np.zeros(len(first), np.int32)
    for row in range(len(first)):
        if count[row] == 0:
            depths[first[row]] = depths[first[row] + 1] = depths[row] + 1
    return depths


@njit(cache=True, nogil=True)
def measure_depth(first, count):  # type: ignore[no-untyped-def]
    """Return the number of edges from the root to the deepest leaf; the parameters are those of `find_depths`."""
    return find_depths(first, count).max()

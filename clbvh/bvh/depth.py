"""Depths of nodes, in one pass: children lie behind their parent."""

from __future__ import annotations

import numpy as np

from ..support.compiled import compiled


@compiled
def find_depths(first, count):
    """Return the number of edges from the root to each node, (N,) int32.

    Parameters
    ----------
    first, count : (N,) int32
        The fields of the nodes, in an order in which children lie behind their parent.
    """
    depths = np.zeros(len(first), np.int32)
    for node in range(len(first)):
        if count[node] == 0:
            depths[first[node]] = depths[first[node] + 1] = depths[node] + 1
    return depths


@compiled
def measure_depth(first, count):
    """Return the number of edges from the root to the deepest leaf; the parameters are those of `find_depths`."""
    # Not numpy's `max`, which takes a second to compile.
    deepest = 0
    for depth in find_depths(first, count):
        deepest = max(deepest, depth)
    return deepest

"""A tree that can be rearranged: every triangle is a leaf of its own, and every node knows its parent.

Node 1 is the root, node 0 is unused, and siblings are nodes 2k and 2k + 1: ``node ^ 1`` is a node's sibling, and one
entry of `parents` serves both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import EXPANDED_FIRST
from ...support.compiled import compiled

ROOT = 1


class ExpandedTree(NamedTuple):
    """The arrays of a tree over n triangles, for compiled loops.

    Attributes
    ----------
    boxes, links : (2n, 8) float32 and int32, the same memory
        Each node's `structs.BOX`. Two of its lanes are integers: `EXPANDED_FIRST`, the first child, 0 for a leaf, and
        `EXPANDED_PRIM_ID`, the leaf's triangle.
    parents : (n,) int32
        ``parents[node >> 1]`` is the parent of a node; 0 for the root.
    """

    boxes: NDArray[np.float32]
    links: NDArray[np.int32]
    parents: NDArray[np.int32]


@compiled
def list_descendants(links, top, descendants):
    """Write the nodes below `top`, level by level, and return their number.

    Parameters
    ----------
    links : (2n, 8) int32
    top : int
    descendants : (>= k,) int32, written
    """
    count = seen = 0
    node = top
    while True:
        child = links[node, EXPANDED_FIRST]
        if child != 0:
            descendants[count], descendants[count + 1] = child, child + 1
            count += 2
        if seen == count:
            return count
        node = descendants[seen]
        seen += 1


@compiled
def count_prims(links, order):
    """Return the number of triangles below each node, (2n,) int32; `order` holds all nodes, parents first."""
    prim_counts = np.empty(len(links), np.int32)
    for index in range(len(order) - 1, -1, -1):
        node = order[index]
        child = links[node, EXPANDED_FIRST]
        prim_counts[node] = 1 if child == 0 else prim_counts[child] + prim_counts[child + 1]
    return prim_counts

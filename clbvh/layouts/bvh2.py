"""The layout `bvh2`: one node per interior node, with the boxes of both children."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    BVH2_NODE,
    NODE_COUNT,
    NODE_FIRST,
    NODE_LANES,
    NODE_MAX,
)
from ..support.compiled import compiled

# A missing child has an inverted box, from the greatest number to the least, which no ray hits.
_GREATEST = np.finfo(np.float32).max


def make_bvh2_nodes(bvh: Bvh) -> NDArray[np.void]:
    """Return the interior nodes with the boxes of both children in each.

    Parameters
    ----------
    bvh : Bvh

    Returns
    -------
    (max(1, interior nodes),) `structs.BVH2_NODE`
        In the tree's depth-first order; node 0 is the root.
    """
    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    interior_count = max(1, len(nodes) // 2)
    bvh2_nodes = np.empty((interior_count, BVH2_LANES), np.float32)
    if len(nodes) == 1:
        lone = bvh2_nodes.view(BVH2_NODE)[0, 0]
        lone["aabb_min"][0], lone["aabb_max"][0] = bvh.nodes["aabb_min"][0], bvh.nodes["aabb_max"][0]
        lone["aabb_min"][1], lone["aabb_max"][1] = _GREATEST, -_GREATEST
        lone["first"], lone["count"] = bvh.nodes["first"][0], bvh.nodes["count"][0]
    else:
        _pair_children(nodes, nodes.view(np.int32), bvh2_nodes, bvh2_nodes.view(np.int32))
    return bvh2_nodes.view(BVH2_NODE).reshape(-1)


@compiled
def _pair_children(nodes, node_ints, bvh2_nodes, bvh2_ints):
    """Write one bvh2 node for each interior node, with the new indices of its children."""
    new_indices = np.empty(len(nodes), np.int32)
    interior_count = 0
    for node in range(len(nodes)):
        new_indices[node] = interior_count
        interior_count += node_ints[node, NODE_COUNT] == 0
    for node in range(len(nodes)):
        if node_ints[node, NODE_COUNT] > 0:
            continue
        target = new_indices[node]
        for side in range(2):
            child = node_ints[node, NODE_FIRST] + side
            for axis in range(3):
                bvh2_nodes[target, BVH2_MIN + 3 * side + axis] = nodes[child, axis]
                bvh2_nodes[target, BVH2_MAX + 3 * side + axis] = nodes[child, NODE_MAX + axis]
            count = node_ints[child, NODE_COUNT]
            bvh2_ints[target, BVH2_FIRST + side] = node_ints[child, NODE_FIRST] if count > 0 else new_indices[child]
            bvh2_ints[target, BVH2_COUNT + side] = count

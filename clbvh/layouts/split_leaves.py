"""Leaves with more triangles than a block holds become subtrees whose leaves fill blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..structs import NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from ..support.compiled import compiled


def split_leaves(bvh: Bvh, leaf_size: int) -> NDArray[np.float32]:
    """Return the nodes of a tree whose leaves have at most `leaf_size` triangles.

    Parameters
    ----------
    bvh : Bvh
        The order of its primitives is kept: all but the last new leaf of each old one are full.
    leaf_size : int

    Returns
    -------
    (N, 8) float32
        Lanes of `structs.NODE`. Siblings are neighbours and lie behind their parent; the order is not depth-first.
    """
    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    counts = bvh.nodes["count"]
    leaf_counts = -(-counts[counts > leaf_size].astype(np.int64) // leaf_size)
    if len(leaf_counts) == 0:
        return nodes
    grown = np.empty((len(nodes) + int((2 * (leaf_counts - 1)).sum()), NODE_LANES), np.float32)
    grown[: len(nodes)] = nodes
    mesh = bvh.mesh
    _split_leaves(grown, grown.view(np.int32), len(nodes), leaf_size, bvh.prim_ids, mesh.local_vertices, mesh.faces)
    return grown


@compiled
def _split_leaves(nodes, node_ints, node_count, leaf_size, prim_ids, vertices, faces):
    node = 0
    while node < node_count:
        count = node_ints[node, NODE_COUNT]
        if count > leaf_size:
            # The left child gets whole blocks. Both children are split further when the loop reaches them.
            first = node_ints[node, NODE_FIRST]
            left_count = (count // leaf_size + (count % leaf_size > 0) + 1) // 2 * leaf_size
            right_first, right_count = first + left_count, count - left_count
            _write_leaf(nodes, node_ints, node_count, first, left_count, prim_ids, vertices, faces)
            _write_leaf(nodes, node_ints, node_count + 1, right_first, right_count, prim_ids, vertices, faces)
            node_ints[node, NODE_FIRST] = node_count
            node_ints[node, NODE_COUNT] = 0
            node_count += 2
        node += 1


@compiled
def _write_leaf(nodes, node_ints, node, first, count, prim_ids, vertices, faces):
    node_ints[node, NODE_FIRST] = first
    node_ints[node, NODE_COUNT] = count
    for axis in range(3):
        least, most = np.inf, -np.inf
        for index in range(first, first + count):
            for corner in range(3):
                coordinate = vertices[faces[prim_ids[index], corner], axis]
                least, most = min(least, coordinate), max(most, coordinate)
        nodes[node, axis], nodes[node, NODE_MAX + axis] = least, most

"""What the device gets, derived from the one tree: nodes in the device's layout, triangles in leaf order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import (
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
    TRIANGLE,
    TRIANGLE_LANES,
    TRIANGLE_PRIM_ID,
)
from .bvh import Bvh

# A child that is not there has its box turned inside out, from the greatest number to the least: no ray is between.
_GREATEST = np.finfo(np.float32).max


def make_bvh2_nodes(bvh: Bvh) -> NDArray[np.void]:
    """Return the interior nodes with the boxes of both children in each.

    Parameters
    ----------
    bvh : Bvh

    Returns
    -------
    (max(1, interior nodes),) `layout.BVH2_NODE`
        In the tree's depth-first order; row 0 is the root.
    """
    rows = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    interior_count = max(1, len(rows) // 2)
    nodes = np.empty((interior_count, BVH2_LANES), np.float32)
    if len(rows) == 1:
        lone = nodes.view(BVH2_NODE)[0, 0]
        lone["aabb_min"][0], lone["aabb_max"][0] = bvh.nodes["aabb_min"][0], bvh.nodes["aabb_max"][0]
        lone["aabb_min"][1], lone["aabb_max"][1] = _GREATEST, -_GREATEST
        lone["first"], lone["count"] = bvh.nodes["first"][0], bvh.nodes["count"][0]
    else:
        _pair_children(rows, rows.view(np.int32), nodes, nodes.view(np.int32))
    return nodes.view(BVH2_NODE).reshape(-1)


@njit(cache=True, nogil=True)
def _pair_children(rows, row_ints, nodes, node_ints):  # type: ignore[no-untyped-def]
    """Write one bvh2 node for each interior row, and renumber the children."""
    numbers = np.empty(len(rows), np.int32)
    interior_count = 0
    for row in range(len(rows)):
        numbers[row] = interior_count
        interior_count += row_ints[row, NODE_COUNT] == 0
    for row in range(len(rows)):
        if row_ints[row, NODE_COUNT] > 0:
            continue
        node = numbers[row]
        for side in range(2):
            child = row_ints[row, NODE_FIRST] + side
            for axis in range(3):
                nodes[node, BVH2_MIN + 3 * side + axis] = rows[child, axis]
                nodes[node, BVH2_MAX + 3 * side + axis] = rows[child, NODE_MAX + axis]
            count = row_ints[child, NODE_COUNT]
            node_ints[node, BVH2_FIRST + side] = row_ints[child, NODE_FIRST] if count > 0 else numbers[child]
            node_ints[node, BVH2_COUNT + side] = count


def gather_triangles(mesh: Mesh, prim_ids: NDArray[np.int32]) -> NDArray[np.void]:
    """Return the mesh's triangles in the given order, each with its corners.

    Parameters
    ----------
    mesh : Mesh
    prim_ids : (n,) int32
        Faces of the mesh: a tree's `prim_ids`, or all faces in order.

    Returns
    -------
    (n,) `layout.TRIANGLE`
        Degenerate triangles have three equal corners.
    """
    triangles: NDArray[Any] = np.empty((len(prim_ids), TRIANGLE_LANES), np.float32)
    _gather(mesh.vertices, mesh.faces, mesh.degenerate_faces, prim_ids, triangles, triangles.view(np.int32))
    return triangles.view(TRIANGLE).reshape(-1)


@njit(cache=True, nogil=True)
def _gather(vertices, faces, degenerate, prim_ids, triangles, triangle_ints):  # type: ignore[no-untyped-def]
    for place in range(len(prim_ids)):
        prim = prim_ids[place]
        for corner in range(3):
            vertex = faces[prim, 0 if degenerate[prim] else corner]
            for axis in range(3):
                triangles[place, 3 * corner + axis] = vertices[vertex, axis]
        triangle_ints[place, TRIANGLE_PRIM_ID] = prim

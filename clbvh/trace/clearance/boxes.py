"""Boxes that lie along the surface, one around each node of a tree.

The boxes of rays are upright. Those of a surface that lies across are as thick as it is wide, and two surfaces that
face each other have thousands of pairs of nodes that could be nearest. See Gottschalk, Lin and Manocha, "OBBTree: a
hierarchical structure for rapid interference detection", 1996. How far apart two of them are is in
cl/clearance/boxes.cl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.loops import Loops

_LOOPS = Loops("clearance/boxes")


def fit_boxes(tree: Bvh) -> NDArray[np.float32]:
    """Return the boxes of the nodes of a mesh's tree, (N, 15): the centre, half the sides, and the three axes.

    Notes
    -----
    O(triangles times depth), in this thread: 60 ms for 100,000 triangles.
    """
    geometry = tree.nodes, tree.prim_ids, np.ascontiguousarray(tree.mesh.to_local(tree.mesh.vertices)), tree.mesh.faces
    parents, normals = np.zeros(tree.node_count, np.int32), np.empty((tree.node_count, 3))
    _LOOPS.sum_normals(*geometry, parents, normals)
    normals[~normals.any(axis=1), 0] = 1.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Across the normal, any direction will do: here one far from parallel to it.
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack((normals, across, np.cross(normals, across)), axis=1).astype(np.float32)
    lower, upper = np.full(normals.shape, np.inf), np.full(normals.shape, -np.inf)
    _LOOPS.measure_nodes(*geometry, parents, axes, lower, upper)
    centres = np.einsum("nk,nka->na", (lower + upper) / 2.0, axes)
    return np.concatenate((centres, (upper - lower) / 2.0, axes.reshape(-1, 9)), axis=1, dtype=np.float32)

"""A tree that is small enough to be written down: four unit triangles in a row, five nodes.

          0: whole
         /        \\
    1: faces 0, 2   2
                   / \\
         3: face 3    4: face 1
"""

import numpy as np

from clbvh import Bvh
from clbvh.structs import NODE

from ..rays import mesh_as_on_device

# Triangle i lies in the square from (2 i, 0) to (2 i + 1, 1), at height i.
FACE_COUNT = 4


def make_mesh():
    corners = [[[2 * i, 0, i], [2 * i + 1, 0, i], [2 * i, 1, i]] for i in range(FACE_COUNT)]
    return mesh_as_on_device(np.reshape(corners, (-1, 3)), np.arange(3 * FACE_COUNT).reshape(-1, 3), "four triangles")


def make_tree():
    """Return a tree whose arrays belong to the caller."""
    nodes = np.array(
        [
            ([0, 0, 0], 1, [7, 1, 3], 0),
            ([0, 0, 0], 0, [5, 1, 2], 2),
            ([2, 0, 1], 3, [7, 1, 3], 0),
            ([6, 0, 3], 2, [7, 1, 3], 1),
            ([2, 0, 1], 3, [3, 1, 1], 1),
        ],
        NODE,
    )
    return Bvh(nodes, np.array([0, 2, 3, 1], np.int32), make_mesh())


def make_leaf(count=FACE_COUNT):
    """Return a tree that is one leaf over the first triangles."""
    whole = make_mesh()
    mesh = mesh_as_on_device(whole.local_vertices, whole.faces[:count], "one leaf")
    nodes = np.array([([0, 0, 0], 0, [2 * count - 1, 1, count - 1], count)], NODE)
    return Bvh(nodes, np.arange(count, dtype=np.int32), mesh)

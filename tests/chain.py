"""A tree made by hand, as deep as its triangles allow."""

import numpy as np

from clbvh import Bvh, validate_tree
from clbvh.structs import NODE

from .rays import mesh_as_on_device


def make_chain(count, leaf_side):
    """Triangles in a row along z, and the deepest tree there is: at each level one leaf, on the given side.

    A triangle covers the lower half of its box, x + y < 2, the last one the upper half: a ray along z there runs
    through all boxes and meets the last triangle only.
    """
    a = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], np.float32)
    triangles = a[None] + np.arange(count, dtype=np.float32)[:, None, None] * np.array([0, 0, 1], np.float32)
    triangles[-1, 0] = [2, 2, count - 1]
    mesh = mesh_as_on_device(triangles.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))

    # Level i splits off triangle i; the rest begins at i + 1.
    nodes = np.zeros(2 * count - 1, NODE)
    parent = 0
    for level in range(count):
        nodes["aabb_min"][parent], nodes["aabb_max"][parent] = (0, 0, level), (2, 2, count - 1)
        if level == count - 1:
            nodes["first"][parent], nodes["count"][parent] = level, 1
            break
        left = nodes["first"][parent] = 2 * level + 1
        leaf, parent = (left, left + 1) if leaf_side == "left" else (left + 1, left)
        nodes["aabb_min"][leaf], nodes["aabb_max"][leaf] = (0, 0, level), (2, 2, level)
        nodes["first"][leaf], nodes["count"][leaf] = level, 1
    bvh = Bvh(nodes, np.arange(count, dtype=np.int32), mesh)
    validate_tree(bvh)
    return mesh, bvh

"""The cost of rays in the layouts `bvh4` and `bvh8`: node visits and triangle tests, counted on the host.

As in `cl/traversal/wide.cl` for the closest hit: nearest child first, and children beyond the nearest hit are skipped
when they are popped. From the root: there are no entry points. Boxes and triangles are tested as in `descend.py`, which
may differ from the device in the last bit of t.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...layouts.leaf_blocks import gather_triangles
from ...layouts.wide import widen
from ...structs import NO_PRIM, PACKED_RAY, TRIANGLE_LANES
from ...support.compiled import compiled
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays
from .descend import intersect_triangle, make_shear, pad_ray
from .visits import Visits

_ZERO, _INFINITY = np.float32(0.0), np.float32(np.inf)


class _WideTree(NamedTuple):
    """The nodes as 4-byte lanes, floats and integers, the faces in each block, and the triangles by face."""

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    blocks: NDArray[np.int32]
    triangles: NDArray[np.float32]
    width: int
    stack_size: int


def count_wide_visits(bvh: Bvh, width: int, origins: ArrayLike, directions: ArrayLike) -> Visits:
    """Cast rays on the host through a wide tree, and count their steps.

    Parameters
    ----------
    bvh : Bvh
    width : int
        4 or 8.
    origins, directions
        See `Tracer.closest_hit`.

    Returns
    -------
    Visits
        A node step tests the boxes of all children of one node; a leaf visit is one block of up to `width` triangles.
    """
    batch, _ = read_rays(origins, directions, 0.0, np.inf)
    rays = np.empty(batch.ray_count, PACKED_RAY)
    pack_rays(batch, batch.part(0, batch.ray_count), TreeBox.around(bvh), rays)
    wide = widen(bvh, width)
    lanes = wide.nodes.view(np.float32).reshape(len(wide.nodes), -1)
    every_face = np.arange(bvh.mesh.face_count, dtype=np.int32)
    triangles = gather_triangles(bvh.mesh, every_face).view(np.float32).reshape(-1, TRIANGLE_LANES)
    tree = _WideTree(lanes, lanes.view(np.int32), wide.blocks, triangles, width, wide.stack_size + width)
    counts = np.zeros((4, len(rays)), np.int32)
    _walk_wide(tree, rays["origin"], rays["direction"], rays["t_min"], rays["t_max"], counts)
    return Visits(*counts)


@compiled(error_model="numpy")
def _walk_wide(tree, origins, directions, t_mins, t_maxs, counts):
    """Traverse the tree with every ray; `counts` holds the fields of `Visits`."""
    nodes, node_ints, width = tree.nodes, tree.node_ints, tree.width
    first_max, first_child = 3 * width, 6 * width
    stack = np.empty(tree.stack_size, np.int64)
    keys = np.empty(tree.stack_size, np.float32)
    near_origin = np.empty(3, np.float32)
    far_origin = np.empty(3, np.float32)
    inverse = np.empty(3, np.float32)
    shear = np.empty(3, np.float32)
    perturbation = np.empty(2, np.float32)
    for ray in range(len(origins)):
        origin, direction = origins[ray], directions[ray]
        t_min, t_max = t_mins[ray], t_maxs[ray]
        z_axis = make_shear(origin, direction, shear, perturbation)
        pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse)
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = triangle_tests = 0
        stack[0], keys[0] = 0, t_min
        stack_size = 1
        while stack_size > 0:
            stack_size -= 1
            limit = nearest_t if nearest_t < t_max else t_max
            if keys[stack_size] > limit:
                continue
            child = stack[stack_size]

            # A block of triangles.
            if child < 0:
                leaf_visits += 1
                for lane in range(width):
                    prim = tree.blocks[~child, lane]
                    if prim == NO_PRIM:
                        continue
                    triangle_tests += 1
                    t = intersect_triangle(tree.triangles, prim, origin, z_axis, shear, perturbation)
                    if t >= t_min and t <= t_max and (t < nearest_t or (t == nearest_t and prim < nearest_prim)):
                        nearest_t, nearest_prim = t, prim
                continue

            # The children that the ray meets go on the stack in order, the nearest on top.
            node_steps += 1
            bottom = stack_size
            for slot in range(width):
                t_near, t_far = t_min, limit
                if nodes[child, slot] > nodes[child, first_max + slot]:
                    continue  # a missing child
                for axis in range(3):
                    lower, upper = nodes[child, axis * width + slot], nodes[child, first_max + axis * width + slot]
                    is_backward = inverse[axis] < _ZERO
                    near = ((upper if is_backward else lower) - near_origin[axis]) * inverse[axis]
                    far = ((lower if is_backward else upper) - far_origin[axis]) * inverse[axis]
                    t_near = near if near > t_near else t_near
                    t_far = far if far < t_far else t_far
                if not t_near <= t_far:
                    continue
                index = stack_size
                while index > bottom and keys[index - 1] < t_near:
                    stack[index], keys[index] = stack[index - 1], keys[index - 1]
                    index -= 1
                stack[index], keys[index] = node_ints[child, first_child + slot], t_near
                stack_size += 1
        counts[0, ray], counts[1, ray], counts[2, ray] = node_steps, leaf_visits, triangle_tests
        counts[3, ray] = nearest_prim

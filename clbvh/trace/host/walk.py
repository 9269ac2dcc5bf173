"""The way of rays through a wide tree on the host, as in `cl/traversal/wide.cl`, with the steps counted.

Boxes are tested as in `descend.py`, with the padding of the device, and triangles to the last bit as on the device: so
the crossings are those of the device, by the proof in docs/internals/padding.md, whatever nodes either of them visits.
"""

from __future__ import annotations

import numpy as np

from ...structs import HIT_PRIM_ID, NO_PRIM, PACKED_RAY_DIRECTION, PACKED_RAY_T_MAX, PACKED_RAY_T_MIN
from ...support.compiled import compiled
from ..oracle.descend import cross_corners, make_shear, pad_ray

_ZERO, _INFINITY = np.float32(0.0), np.float32(np.inf)

# What is counted of each ray, and the answer, by index: the nearest primitive, where a device's hit has it, or the number
# of crossings.
NODE_STEPS, LEAF_VISITS, TRIANGLE_TESTS, ANSWER = 0, 1, 2, HIT_PRIM_ID
FIELD_COUNT = 4

# Most children of a node.
_MOST_SLOTS = 8


@compiled(error_model="numpy")
def walk(tree, packed, most_crossings, found):
    """Traverse the tree with every ray.

    Parameters
    ----------
    tree : WideArrays
    packed : (n, 8) float32
        Lanes of `structs.PACKED_RAY`.
    most_crossings : int
        0: find the nearest crossing. Otherwise count crossings, up to this number.
    found : (n, FIELD_COUNT) int32, written
    """
    nodes, node_ints, blocks, block_ints = tree.nodes, tree.node_ints, tree.blocks, tree.block_ints
    width = np.uint64(len(tree.slots))
    lanes_of_node, lanes_of_block = np.uint64(7) * width, np.uint64(10) * width
    first_child, first_prim = np.uint64(6) * width, np.uint64(9) * width
    one, three = np.uint64(1), np.uint64(3)
    stack = np.empty(tree.stack_size, np.int32)
    keys = np.empty(tree.stack_size, np.float32)
    origin = np.empty(3, np.float32)
    direction = np.empty(3, np.float32)
    near_origin = np.empty(3, np.float32)
    far_origin = np.empty(3, np.float32)
    inverse = np.empty(3, np.float32)
    shear = np.empty(3, np.float32)
    perturbation = np.empty(2, np.float32)
    t_nears = np.empty(_MOST_SLOTS, np.float32)
    t_fars = np.empty(_MOST_SLOTS, np.float32)
    for ray in range(len(packed)):
        for axis in range(3):
            origin[axis], direction[axis] = packed[ray, axis], packed[ray, PACKED_RAY_DIRECTION + axis]
        t_min, t_max = packed[ray, PACKED_RAY_T_MIN], packed[ray, PACKED_RAY_T_MAX]
        z_axis = make_shear(origin, direction, shear, perturbation)
        pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse)
        near_x, near_y, near_z = near_origin[0], near_origin[1], near_origin[2]
        far_x, far_y, far_z = far_origin[0], far_origin[1], far_origin[2]
        inverse_x, inverse_y, inverse_z = inverse[0], inverse[1], inverse[2]
        # Offsets of the near and the far planes in a node, per axis.
        min_x, min_y, min_z = np.uint64(0), width, width + width
        apart = three * width
        x_near, x_far = (min_x + apart, min_x) if inverse_x < _ZERO else (min_x, min_x + apart)
        y_near, y_far = (min_y + apart, min_y) if inverse_y < _ZERO else (min_y, min_y + apart)
        z_near, z_far = (min_z + apart, min_z) if inverse_z < _ZERO else (min_z, min_z + apart)
        shear_x, shear_y, shear_z = shear[0], shear[1], shear[2]
        x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
        # Offsets of the coordinates of the first corner in a block, after the axes have been permuted.
        x_lane, y_lane, z_lane = np.uint64(x_axis) * width, np.uint64(y_axis) * width, np.uint64(z_axis) * width
        origin_x, origin_y, origin_z = origin[x_axis], origin[y_axis], origin[z_axis]
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = triangle_tests = crossings = 0
        limit = t_max
        stack[0], keys[0] = 0, t_min
        stack_size = 1
        while stack_size > 0:
            stack_size -= 1
            if keys[stack_size] > limit:
                continue
            child = stack[stack_size]

            # A block of triangles.
            if child < 0:
                leaf_visits += 1
                base = np.uint64(~child) * lanes_of_block
                for slot in range(len(tree.slots)):
                    lane = base + np.uint64(slot)
                    prim = block_ints[lane + first_prim]
                    if prim == NO_PRIM:
                        continue
                    triangle_tests += 1
                    az = blocks[lane + z_lane] - origin_z
                    ax = blocks[lane + x_lane] - origin_x - shear_x * az
                    ay = blocks[lane + y_lane] - origin_y - shear_y * az
                    lane += apart
                    bz = blocks[lane + z_lane] - origin_z
                    bx = blocks[lane + x_lane] - origin_x - shear_x * bz
                    by = blocks[lane + y_lane] - origin_y - shear_y * bz
                    lane += apart
                    cz = blocks[lane + z_lane] - origin_z
                    cx = blocks[lane + x_lane] - origin_x - shear_x * cz
                    cy = blocks[lane + y_lane] - origin_y - shear_y * cz
                    # Plain differences may vanish but never have the wrong sign. They reject most triangles.
                    edge_a, edge_b, edge_c = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
                    if not (
                        (edge_a >= _ZERO and edge_b >= _ZERO and edge_c >= _ZERO)
                        or (edge_a <= _ZERO and edge_b <= _ZERO and edge_c <= _ZERO)
                    ):
                        continue
                    t = cross_corners(
                        ax, ay, shear_z * az, bx, by, shear_z * bz, cx, cy, shear_z * cz, perturbation
                    )
                    if t >= t_min and t <= t_max:
                        if most_crossings > 0:
                            crossings += crossings < most_crossings
                        elif t < nearest_t or (t == nearest_t and prim < nearest_prim):
                            nearest_t, nearest_prim, limit = t, prim, t
                if most_crossings > 0 and crossings == most_crossings:
                    break
                continue

            # The children that the ray meets go on the stack in order, the nearest on top.
            node_steps += 1
            base = np.uint64(child) * lanes_of_node
            for slot in range(len(tree.slots)):
                lane = base + np.uint64(slot)
                t_near, t_far = t_min, limit
                near = (nodes[lane + z_near] - near_z) * inverse_z
                far = (nodes[lane + z_far] - far_z) * inverse_z
                t_near = near if near > t_near else t_near
                t_far = far if far < t_far else t_far
                near = (nodes[lane + y_near] - near_y) * inverse_y
                far = (nodes[lane + y_far] - far_y) * inverse_y
                t_near = near if near > t_near else t_near
                t_far = far if far < t_far else t_far
                near = (nodes[lane + x_near] - near_x) * inverse_x
                far = (nodes[lane + x_far] - far_x) * inverse_x
                t_nears[slot] = near if near > t_near else t_near
                t_fars[slot] = far if far < t_far else t_far
            bottom = stack_size
            for slot in range(len(tree.slots)):
                t_near = t_nears[slot]
                if not t_near <= t_fars[slot]:
                    continue
                lane = base + np.uint64(slot)
                if nodes[lane] > nodes[lane + apart]:
                    continue  # a missing child
                index = stack_size
                while index > bottom and keys[index - 1] < t_near:
                    stack[index], keys[index] = stack[index - 1], keys[index - 1]
                    index -= 1
                stack[index], keys[index] = node_ints[lane + first_child], t_near
                stack_size += 1
        found[ray, NODE_STEPS], found[ray, LEAF_VISITS], found[ray, TRIANGLE_TESTS] = (
            node_steps, leaf_visits, triangle_tests,
        )  # fmt: skip
        found[ray, ANSWER] = nearest_prim if most_crossings == 0 else crossings

"""The way of rays through a wide tree on the host, as in `cl/traversal/wide.cl`, with the steps counted.

Boxes are tested as in `cl/boxes/aabb.cl`, with the padding of the device, and triangles to the last bit as on the
device. So the crossings are those of the device, whatever nodes either visits: docs/internals/padding.md has the proof.
"""

from __future__ import annotations

import numpy as np

from ...structs import HIT_PRIM_ID, NO_PRIM, PACKED_RAY_DIRECTION, PACKED_RAY_T_MAX, PACKED_RAY_T_MIN
from ...support.compiled import compiled
from .lanes import lowest_bit, meet_boxes, pass_edges
from .ray import cross_corners, make_shear, pad_ray

_ZERO, _INFINITY = np.float32(0.0), np.float32(np.inf)
_NO_BITS, _LAST_BIT = np.uint32(0), np.uint32(1)

# What is counted of each ray, and the answer, by index: the nearest primitive, where a device's hit has it, or the
# number of crossings.
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
    x_plane, y_plane, z_plane, apart = np.uint64(0), width, width + width, width + width + width
    for ray in range(len(packed)):
        for axis in range(3):
            origin[axis], direction[axis] = packed[ray, axis], packed[ray, PACKED_RAY_DIRECTION + axis]
        t_min, t_max = packed[ray, PACKED_RAY_T_MIN], packed[ray, PACKED_RAY_T_MAX]
        z_axis = make_shear(origin, direction, shear, perturbation)
        pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse)
        near_point = near_origin[0], near_origin[1], near_origin[2]
        far_point = far_origin[0], far_origin[1], far_origin[2]
        slopes = inverse[0], inverse[1], inverse[2]
        # Offsets of the near planes and the far ones in a node: the minima come first, then the maxima.
        near_x, far_x = (x_plane + apart, x_plane) if slopes[0] < _ZERO else (x_plane, x_plane + apart)
        near_y, far_y = (y_plane + apart, y_plane) if slopes[1] < _ZERO else (y_plane, y_plane + apart)
        near_z, far_z = (z_plane + apart, z_plane) if slopes[2] < _ZERO else (z_plane, z_plane + apart)
        x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
        axes = np.uint64(x_axis), np.uint64(y_axis), np.uint64(z_axis)
        point = origin[x_axis], origin[y_axis], origin[z_axis]
        slants = shear[0], shear[1]
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
                    triangle_tests += block_ints[base + first_prim + np.uint64(slot)] != NO_PRIM
                passing = pass_edges(tree.slots, blocks, base, axes, point, slants)
                while passing != _NO_BITS:
                    lane = base + lowest_bit(passing)
                    passing &= passing - _LAST_BIT
                    t = _cross(blocks, lane, width, axes, point, shear, perturbation)
                    if t >= t_min and t <= t_max:
                        prim = block_ints[lane + first_prim]
                        if most_crossings > 0:
                            crossings += crossings < most_crossings
                        elif t < nearest_t or (t == nearest_t and prim < nearest_prim):
                            nearest_t, nearest_prim = t, prim
                            limit = t
                if most_crossings > 0 and crossings == most_crossings:
                    break
                continue

            # The children that the ray meets go on the stack in order, the nearest on top.
            node_steps += 1
            base = np.uint64(child) * lanes_of_node
            met = meet_boxes(
                tree.slots, nodes, (base + near_x, base + near_y, base + near_z),
                (base + far_x, base + far_y, base + far_z), near_point, far_point, slopes, (t_min, limit), t_nears,
            )  # fmt: skip
            bottom = stack_size
            while met != _NO_BITS:
                slot = lowest_bit(met)
                met &= met - _LAST_BIT
                lane = base + slot
                if nodes[lane] > nodes[lane + apart]:
                    continue  # a missing child
                t_near = t_nears[slot]
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


@compiled(error_model="numpy")
def _cross(blocks, lane, width, axes, origin, shear, perturbation):
    """Return t where the ray crosses the triangle of a lane, NaN if it does not."""
    ax, ay, az = _shear_corner(blocks, lane, width, axes, origin, shear)
    lane += width + width + width
    bx, by, bz = _shear_corner(blocks, lane, width, axes, origin, shear)
    lane += width + width + width
    cx, cy, cz = _shear_corner(blocks, lane, width, axes, origin, shear)
    return cross_corners(ax, ay, az, bx, by, bz, cx, cy, cz, perturbation)


@compiled(error_model="numpy")
def _shear_corner(blocks, lane, width, axes, origin, shear):
    x = blocks[lane + axes[0] * width] - origin[0]
    y = blocks[lane + axes[1] * width] - origin[1]
    z = blocks[lane + axes[2] * width] - origin[2]
    return x - shear[0] * z, y - shear[1] * z, shear[2] * z

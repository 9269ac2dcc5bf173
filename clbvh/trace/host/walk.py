"""Few rays, cast by threads of the host: the way of rays through a wide tree, with the steps counted.

To hand launches to the driver and to be woken by it takes longer than to cast a few thousand rays. The tree is that of
the device, where host and device share their memory. Rays are packed as for the device, and hits are refined by the
usual float64 step. A sample of many rays tells what they cost.

The traversal is that of `cl/traversal/wide.cl`. Boxes are tested as in `cl/boxes/aabb.cl`, with the padding of the
device, and triangles to the last bit as on the device. So the crossings are those of the device, whatever nodes either
visits: docs/internals/padding.md has the proof.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import (
    HIT_PRIM_ID,
    NO_PRIM,
    PACKED_RAY_DIRECTION,
    PACKED_RAY_LANES,
    PACKED_RAY_T_MAX,
    PACKED_RAY_T_MIN,
)
from ...support.compiled import compiled
from ..rays.batch import RayBatch
from ..rays.pack import ALL_GOOD, NO_LOWS, explain_bad_ray, write_packed
from ..world.tree_box import TreeBox
from ..world.trees import WideArrays
from .lanes import count_others, cross_corners, lowest_bit, make_host_ray, meet_boxes, pass_edges, shear_corner


def cast_on_host(
    tree: WideArrays, box: TreeBox, batch: RayBatch, most_crossings: int, begin: int, end: int
) -> NDArray[Any]:
    """Return what a kernel finds for rays `begin` to `end` of a batch.

    Parameters
    ----------
    tree : WideArrays
        Of a mesh.
    box : TreeBox
        Around it.
    batch : RayBatch
    most_crossings : int
        0: the closest hit is wanted. Otherwise the number of crossings, up to this one.

    Returns
    -------
    (n,) int32
        The primitive of the closest hit, `NO_PRIM` on a miss; or the number of crossings.

    Raises
    ------
    QueryError
        A bad ray; see `pack_rays`.
    """
    found, bad = _find(tree, box, batch, most_crossings, begin, end)
    if bad != ALL_GOOD:
        raise explain_bad_ray(batch, begin + bad)
    return found[:, ANSWER]


def mean_steps(tree: WideArrays, box: TreeBox, batch: RayBatch) -> float:
    """Return how many nodes and leaves a ray of a batch visits for its closest hit, on average; at least one ray.

    Of a batch with a bad ray, the answer is infinity.
    """
    found, bad = _find(tree, box, batch, 0, 0, batch.ray_count)
    return float(found[:, NODE_STEPS].mean() + found[:, LEAF_VISITS].mean()) if bad == ALL_GOOD else math.inf


def _find(
    tree: WideArrays, box: TreeBox, batch: RayBatch, most_crossings: int, begin: int, end: int
) -> tuple[NDArray[np.int32], int]:
    """Return what `walk` finds for each of some rays, (n, FIELD_COUNT), and what `write_packed` returns."""
    count = end - begin
    packed, found = np.empty((count, PACKED_RAY_LANES), np.float32), np.empty((count, FIELD_COUNT), np.int32)
    return found, _cast(batch.part(begin, end), box, tree, most_crossings, packed, found, NO_LOWS)


@compiled
def _cast(rays, box, tree, most_crossings, packed, found, no_lows):
    """Pack rays and traverse the tree with them; return as `write_packed`."""
    bad = write_packed(rays, box, None, packed, no_lows, no_lows)
    if bad == ALL_GOOD:
        walk(tree, packed, most_crossings, found)
    return bad


_ZERO, _INFINITY = np.float32(0.0), np.float32(np.inf)
_NO_BITS, _LAST_BIT = np.uint32(0), np.uint32(1)
_HALF_BITS, _LOWER_HALF = np.uint64(32), np.uint64(0xFFFFFFFF)

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
    # Entries as on the device: t_near of a child's box in the upper half, the child in the lower one.
    stack = np.empty(tree.stack_size, np.uint64)
    t_nears = np.empty(_MOST_SLOTS, np.uint32)
    x_plane, y_plane, z_plane, apart = np.uint64(0), width, width + width, width + width + width
    for ray_id in range(len(packed)):
        # 0 for -0, so that the bits of all t_near are in the order of their values.
        t_min, t_max = packed[ray_id, PACKED_RAY_T_MIN] + _ZERO, packed[ray_id, PACKED_RAY_T_MAX]
        ray = make_host_ray(
            (packed[ray_id, 0], packed[ray_id, 1], packed[ray_id, 2]),
            (
                packed[ray_id, PACKED_RAY_DIRECTION],
                packed[ray_id, PACKED_RAY_DIRECTION + 1],
                packed[ray_id, PACKED_RAY_DIRECTION + 2],
            ),
        )
        # Offsets of the near planes and the far ones in a node: the minima come first, then the maxima.
        near_x, far_x = (x_plane + apart, x_plane) if ray.inverse[0] < _ZERO else (x_plane, x_plane + apart)
        near_y, far_y = (y_plane + apart, y_plane) if ray.inverse[1] < _ZERO else (y_plane, y_plane + apart)
        near_z, far_z = (z_plane + apart, z_plane) if ray.inverse[2] < _ZERO else (z_plane, z_plane + apart)
        axes = np.uint64(ray.axes[0]), np.uint64(ray.axes[1]), np.uint64(ray.axes[2])
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = triangle_tests = crossings = 0
        limit = t_max
        child = np.int32(0)
        stack_size = 0
        is_done = t_min > t_max
        while not is_done:
            if child >= 0:
                # The nearest child that the ray meets comes next, others go on the stack in order.
                node_steps += 1
                base = np.uint64(child) * lanes_of_node
                met = meet_boxes(
                    tree.slots, nodes, (base + near_x, base + near_y, base + near_z),
                    (base + far_x, base + far_y, base + far_z), ray.near_origin, ray.far_origin, ray.inverse,
                    (t_min, limit), t_nears,
                )  # fmt: skip
                if met != _NO_BITS:
                    children = base + first_child
                    slot = lowest_bit(met)
                    met &= met - _LAST_BIT
                    child = node_ints[children + slot]
                    if met == _NO_BITS:
                        continue
                    nearest = _make_entry(t_nears[slot], child)
                    bottom = stack_size
                    while met != _NO_BITS:
                        slot = lowest_bit(met)
                        met &= met - _LAST_BIT
                        other = _make_entry(t_nears[slot], node_ints[children + slot])
                        farther = max(nearest, other)
                        nearest = min(nearest, other)
                        index = stack_size
                        stack_size += 1
                        while index > bottom and stack[index - 1] < farther:
                            stack[index] = stack[index - 1]
                            index -= 1
                        stack[index] = farther
                    child = _child_of(nearest)
                    continue
            else:
                # A block of triangles.
                leaf_visits += 1
                base = np.uint64(~child) * lanes_of_block
                triangle_tests += np.int64(count_others(tree.slots, block_ints, base + first_prim, np.int32(NO_PRIM)))
                passing = pass_edges(tree.slots, blocks, base, axes, ray.origin, (ray.shear[0], ray.shear[1]))
                while passing != _NO_BITS:
                    lane = base + lowest_bit(passing)
                    passing &= passing - _LAST_BIT
                    t = _cross(blocks, lane, width, axes, ray)
                    if t >= t_min and t <= t_max:
                        prim = block_ints[lane + first_prim]
                        if most_crossings > 0:
                            crossings += crossings < most_crossings
                        elif t < nearest_t or (t == nearest_t and prim < nearest_prim):
                            nearest_t, nearest_prim = t, prim
                            limit = t
                if most_crossings > 0 and crossings == most_crossings:
                    break

            # Children beyond the nearest hit are skipped.
            beyond = _make_entry(np.float32(limit).view(np.uint32), np.int32(-1))
            is_done = True
            while stack_size > 0:
                stack_size -= 1
                if stack[stack_size] <= beyond:
                    child = _child_of(stack[stack_size])
                    is_done = False
                    break
        found[ray_id, NODE_STEPS], found[ray_id, LEAF_VISITS], found[ray_id, TRIANGLE_TESTS] = (
            node_steps, leaf_visits, triangle_tests,
        )  # fmt: skip
        found[ray_id, ANSWER] = nearest_prim if most_crossings == 0 else crossings


@compiled
def _make_entry(t_near, child):
    """Return a stack entry; entries are in the order of t_near, given by its bits, then of the child's bits."""
    return (np.uint64(t_near) << _HALF_BITS) | np.uint64(np.uint32(child))


@compiled
def _child_of(entry):
    return np.int32(np.uint32(entry & _LOWER_HALF))


@compiled(error_model="numpy", is_inlined=True)
def _cross(blocks, lane, width, axes, ray):
    """Return t where the ray crosses the triangle of a lane, NaN if it does not."""
    corner = width + width + width
    a = _load_corner(blocks, lane, width, axes)
    b = _load_corner(blocks, lane + corner, width, axes)
    c = _load_corner(blocks, lane + corner + corner, width, axes)
    return cross_corners(shear_corner(a, ray), shear_corner(b, ray), shear_corner(c, ray), ray.perturbation)


@compiled(error_model="numpy", is_inlined=True)
def _load_corner(blocks, lane, width, axes):
    return blocks[lane + axes[0] * width], blocks[lane + axes[1] * width], blocks[lane + axes[2] * width]

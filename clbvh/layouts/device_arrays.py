"""The arrays that a device gets of one tree, by the name of the layout, and the nodes of the layout `bvh2`.

Owns the choice among the layouts of this room. Knows nothing of OpenCL. A node of `bvh2` is an interior node with the
boxes of both children.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry import Shape, Spheres
from ..structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    BVH2_NODE,
    LAYOUT_WIDTHS,
    NODE_COUNT,
    NODE_FIRST,
    NODE_LANES,
    NODE_MAX,
    SPHERE,
    SPHERE_BLOCKS,
    TRIANGLE,
    TRIANGLE_BLOCKS,
)
from ..support.compiled import compiled
from .leaf_blocks import gather_blocks
from .wide import widen


@dataclass(frozen=True, eq=False)
class DeviceArrays:
    """The arrays of one tree in one layout.

    Attributes
    ----------
    nodes, blocks : arrays of structs
        See `clbvh.structs`. A block of `bvh2` is one primitive.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: NDArray[np.void]
    stack_size: int


def make_device_arrays(bvh: Bvh, layout: str) -> DeviceArrays:
    """Return a tree in a layout.

    Parameters
    ----------
    bvh : Bvh
        Over a mesh or spheres.
    layout : str
        One of `structs.LAYOUT_WIDTHS`.
    """
    width, shape = LAYOUT_WIDTHS[layout], cast(Shape, bvh.shape)
    if width == 2:
        blocks = gather_blocks(shape, bvh.prim_ids.reshape(-1, 1))
        return DeviceArrays(make_bvh2_nodes(bvh), blocks, bvh.depth)
    tree = widen(bvh, width)
    blocks = gather_blocks(shape, tree.blocks)
    # An entry point, see cl/traversal/entry_point.cl, can push up to width - 1 children that a descent from the root
    # would not push.
    return DeviceArrays(tree.nodes, blocks, tree.stack_size + width - 1)


def list_prims(shape: Shape) -> DeviceArrays:
    """Return the primitives of a shape in their order, without a tree: the layout ``"brute"``."""
    order = np.arange(shape.prim_count, dtype=np.int32).reshape(-1, 1)
    return DeviceArrays(np.empty(0, BVH2_NODE), gather_blocks(shape, order), 0)


def measure_device_bytes(bvh: Bvh, layout: str) -> int:
    """Return the size of the arrays; the blocks are only counted, not made."""
    width = LAYOUT_WIDTHS[layout]
    is_spheres = isinstance(bvh.shape, Spheres)
    if width == 2:
        # A tree of one leaf still has one node on the device.
        prim_bytes = (SPHERE if is_spheres else TRIANGLE).itemsize
        return max(1, bvh.node_count // 2) * BVH2_NODE.itemsize + len(bvh.prim_ids) * prim_bytes
    tree = widen(bvh, width)
    blocks = SPHERE_BLOCKS if is_spheres else TRIANGLE_BLOCKS
    return int(tree.nodes.nbytes) + len(tree.blocks) * blocks[width].itemsize


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

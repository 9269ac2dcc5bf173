"""The arrays that a device gets of one tree, by the name of the layout, and the nodes of the layout `bvh2`.

Owns the choice among the layouts of this room. Knows nothing of OpenCL. A node of `bvh2` is an interior node with the
boxes of both children.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry import Mesh, Shape
from ..geometry.corners import Bounded
from ..geometry.joined_shapes import batch_small
from ..structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    BVH2_NODE,
    COMPACT_LAYOUT,
    LAYOUT_WIDTHS,
    NODE_COUNT,
    NODE_FIRST,
    NODE_LANES,
    NODE_MAX,
    SHARED_UNIT,
)
from ..support.compiled import compiled
from ..support.host_threads import HostThreads
from .leaf_blocks import LeafBlocks, block_struct
from .shared_blocks import SharedBlocks
from .small_trees import widen_small
from .wide import WideTree, widen


@dataclass(frozen=True, eq=False)
class DeviceArrays:
    """The arrays of one tree in one layout.

    Attributes
    ----------
    nodes : array of structs
        See `clbvh.structs`.
    blocks : LeafBlocks or SharedBlocks
        A block of `bvh2` is one primitive.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: LeafBlocks | SharedBlocks
    stack_size: int

    @property
    def byte_count(self) -> int:
        """Bytes of all arrays."""
        return int(self.nodes.nbytes) + self.blocks.item_count * self.blocks.struct.itemsize


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
        return DeviceArrays(make_bvh2_nodes(bvh), LeafBlocks(shape, bvh.prim_ids.reshape(-1, 1)), bvh.depth)
    with HostThreads() as threads:
        return _of_wide(shape, widen(bvh, width, threads), layout, threads)


def make_all_arrays(bvhs: Sequence[Bvh], layout: str) -> list[DeviceArrays]:
    """Return what `make_device_arrays` does of each tree; many small ones take less time together."""
    small: dict[int, DeviceArrays] = {}
    width = LAYOUT_WIDTHS[layout]
    if width > 2:
        with HostThreads() as threads:
            for batch in batch_small([bvh.shape for bvh in bvhs]):
                wide = widen_small([bvhs[number] for number in batch], width)
                for number, tree in zip(batch, wide, strict=True):
                    small[number] = _of_wide(cast(Shape, bvhs[number].shape), tree, layout, threads)
    return [small.get(number) or make_device_arrays(bvh, layout) for number, bvh in enumerate(bvhs)]


def _of_wide(shape: Shape, tree: WideTree, layout: str, threads: HostThreads) -> DeviceArrays:
    blocks: LeafBlocks | SharedBlocks = LeafBlocks(shape, tree.blocks)
    if has_shared_blocks(shape, layout):
        blocks = SharedBlocks.make(shape, tree.blocks, tree.nodes["child"], threads)
    # An entry point, see cl/traversal/entry_point.cl, can push up to width - 1 children that a descent from the root
    # would not push.
    return DeviceArrays(tree.nodes, blocks, tree.stack_size + LAYOUT_WIDTHS[layout] - 1)


def has_shared_blocks(shape: Bounded, layout: str) -> TypeGuard[Mesh]:
    """Return whether the blocks of a tree are `SharedBlocks`: of a mesh in the layout `bvh8c`."""
    return layout == COMPACT_LAYOUT and isinstance(shape, Mesh)


def item_struct(shape: Bounded, layout: str) -> np.dtype:
    """Return the struct that the blocks of a tree consist of, or of the primitives without a tree."""
    width = LAYOUT_WIDTHS.get(layout, 2)
    return SHARED_UNIT if has_shared_blocks(shape, layout) else block_struct(shape, width if width > 2 else 1)


def list_prims(shape: Shape) -> DeviceArrays:
    """Return the primitives of a shape in their order, without a tree: the layout ``"brute"``."""
    order = np.arange(shape.prim_count, dtype=np.int32).reshape(-1, 1)
    return DeviceArrays(np.empty(0, BVH2_NODE), LeafBlocks(shape, order), 0)


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

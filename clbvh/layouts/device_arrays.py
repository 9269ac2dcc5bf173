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
from ..device.host.loops import Loops
from ..geometry import Mesh, Shape
from ..geometry.joined_shapes import batch_small
from ..geometry.spheres import Bounded
from ..support.host_threads import HostThreads
from ..tree_layouts import BVH2_NODE, LAYOUTS
from .leaf_blocks import LeafBlocks
from .shared_blocks import SharedBlocks
from .small_trees import widen_small
from .wide import WideTree, widen


@dataclass(frozen=True, eq=False)
class DeviceArrays:
    """The arrays of one tree in one layout.

    Attributes
    ----------
    nodes : array of structs
        See `Layout.node`.
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
        One of `TREE_LAYOUTS`.
    """
    shape = cast(Shape, bvh.shape)
    if not LAYOUTS[layout].is_wide:
        return DeviceArrays(make_bvh2_nodes(bvh), LeafBlocks(shape, bvh.prim_ids.reshape(-1, 1)), bvh.depth)
    with HostThreads() as threads:
        return _of_wide(shape, widen(bvh, LAYOUTS[layout].width, threads), layout, threads)


def make_all_arrays(bvhs: Sequence[Bvh], layout: str) -> list[DeviceArrays]:
    """Return what `make_device_arrays` does of each tree; many small ones take less time together."""
    small: dict[int, DeviceArrays] = {}
    if LAYOUTS[layout].is_wide:
        with HostThreads() as threads:
            for batch in batch_small([bvh.shape for bvh in bvhs]):
                wide = widen_small([bvhs[number] for number in batch], LAYOUTS[layout].width)
                for number, tree in zip(batch, wide, strict=True):
                    small[number] = _of_wide(cast(Shape, bvhs[number].shape), tree, layout, threads)
    return [small.get(number) or make_device_arrays(bvh, layout) for number, bvh in enumerate(bvhs)]


def _of_wide(shape: Shape, tree: WideTree, layout: str, threads: HostThreads) -> DeviceArrays:
    blocks: LeafBlocks | SharedBlocks = LeafBlocks(shape, tree.blocks)
    if has_shared_blocks(shape, layout):
        blocks = SharedBlocks.make(shape, tree.blocks, tree.nodes, threads)
    return DeviceArrays(tree.nodes, blocks, tree.stack_size + LAYOUTS[layout].entry_stack)


def has_shared_blocks(shape: Bounded, layout: str) -> TypeGuard[Mesh]:
    """Return whether the blocks of a tree are `SharedBlocks`: of a mesh in the layout `bvh8c`."""
    return LAYOUTS[layout].shares_vertices and isinstance(shape, Mesh)


def list_prims(shape: Shape) -> DeviceArrays:
    """Return the primitives of a shape in their order, without a tree: the layout ``"brute"``."""
    order = np.arange(shape.prim_count, dtype=np.int32).reshape(-1, 1)
    return DeviceArrays(np.empty(0, BVH2_NODE), LeafBlocks(shape, order), 0)


_LOOPS = Loops("layouts/bvh2")


def make_bvh2_nodes(bvh: Bvh) -> NDArray[np.void]:
    """Return the interior nodes with the boxes of both children in each.

    Parameters
    ----------
    bvh : Bvh

    Returns
    -------
    (max(1, interior nodes),) `BVH2_NODE`
        In the tree's depth-first order; node 0 is the root.
    """
    nodes = np.ascontiguousarray(bvh.nodes)
    bvh2_nodes = np.empty(max(1, len(nodes) // 2), BVH2_NODE)
    _LOOPS.pair_children(nodes, np.empty(len(nodes), np.int32), bvh2_nodes)
    return bvh2_nodes

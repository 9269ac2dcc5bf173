"""The arrays that a device gets of one tree, by the name of the layout.

Owns the choice among the layouts of this room. Knows nothing of OpenCL.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..structs import BVH2_NODE, LAYOUT_WIDTHS, TRIANGLE, TRIANGLE_BLOCKS
from .bvh2 import make_bvh2_nodes
from .leaf_blocks import gather_blocks, gather_triangles
from .wide import widen


@dataclass(frozen=True, eq=False)
class DeviceArrays:
    """The arrays of one tree in one layout.

    Attributes
    ----------
    nodes, blocks : arrays of structs
        See `clbvh.structs`. A block of `bvh2` is one triangle.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: NDArray[np.void]
    stack_size: int


def make_device_arrays(bvh: Bvh, layout: str) -> DeviceArrays:
    """Return a tree in the layout of that name, one of `structs.LAYOUT_WIDTHS`."""
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        return DeviceArrays(make_bvh2_nodes(bvh), gather_triangles(bvh.mesh, bvh.prim_ids), bvh.depth)
    tree = widen(bvh, width)
    # An entry point, see cl/traversal/entry_point.cl, can push up to width - 1 children that a descent from the root
    # would not push.
    return DeviceArrays(tree.nodes, gather_blocks(bvh.mesh, tree.blocks), tree.stack_size + width - 1)


def measure_device_bytes(bvh: Bvh, layout: str) -> int:
    """Return the size of the arrays; the blocks are only counted, not made."""
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        # A tree of one leaf still has one node on the device.
        return max(1, bvh.node_count // 2) * BVH2_NODE.itemsize + len(bvh.prim_ids) * TRIANGLE.itemsize
    tree = widen(bvh, width)
    return int(tree.nodes.nbytes) + len(tree.blocks) * TRIANGLE_BLOCKS[width].itemsize

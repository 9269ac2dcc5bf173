"""The arrays that a device gets of one tree, by the name of the layout.

Owns the choice among the layouts of this room. Knows nothing of OpenCL.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry import Mesh, Shape, Spheres
from ..structs import BVH2_NODE, LAYOUT_WIDTHS, SPHERE, SPHERE_BLOCKS, TRIANGLE, TRIANGLE_BLOCKS
from .bvh2 import make_bvh2_nodes
from .leaf_blocks import FaceNumbers, gather_blocks, gather_triangles
from .sphere_blocks import gather_sphere_blocks, gather_spheres
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


def make_device_arrays(
    bvh: Bvh, layout: str, shape: Shape | None = None, face_numbers: FaceNumbers | None = None
) -> DeviceArrays:
    """Return a tree in a layout.

    Parameters
    ----------
    bvh : Bvh
    layout : str
        One of `structs.LAYOUT_WIDTHS`.
    shape : Mesh or Spheres, optional
        What the tree was built over, see `builders.build.build_over`; the tree's own mesh if left out.
    face_numbers : FaceNumbers, optional
        Of a mesh whose faces the device is to know by other numbers.
    """
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        blocks = (
            gather_spheres(shape, bvh.prim_ids)
            if isinstance(shape, Spheres)
            else gather_triangles(bvh.mesh, bvh.prim_ids, face_numbers)
        )
        return DeviceArrays(make_bvh2_nodes(bvh), blocks, bvh.depth)
    tree = widen(bvh, width)
    blocks = (
        gather_sphere_blocks(shape, tree.blocks)
        if isinstance(shape, Spheres)
        else gather_blocks(bvh.mesh, tree.blocks, face_numbers)
    )
    # An entry point, see cl/traversal/entry_point.cl, can push up to width - 1 children that a descent from the root
    # would not push.
    return DeviceArrays(tree.nodes, blocks, tree.stack_size + width - 1)


def list_prims(shape: Shape) -> DeviceArrays:
    """Return the primitives of a shape in their order, without a tree: the layout ``"brute"``."""
    order = np.arange(shape.prim_count, dtype=np.int32)
    blocks = gather_triangles(shape, order) if isinstance(shape, Mesh) else gather_spheres(shape, order)
    return DeviceArrays(np.empty(0, BVH2_NODE), blocks, 0)


def measure_device_bytes(bvh: Bvh, layout: str, shape: Shape | None = None) -> int:
    """Return the size of the arrays; the blocks are only counted, not made."""
    width = LAYOUT_WIDTHS[layout]
    is_spheres = isinstance(shape, Spheres)
    if width == 2:
        # A tree of one leaf still has one node on the device.
        prim_bytes = (SPHERE if is_spheres else TRIANGLE).itemsize
        return max(1, bvh.node_count // 2) * BVH2_NODE.itemsize + len(bvh.prim_ids) * prim_bytes
    tree = widen(bvh, width)
    blocks = SPHERE_BLOCKS if is_spheres else TRIANGLE_BLOCKS
    return int(tree.nodes.nbytes) + len(tree.blocks) * blocks[width].itemsize

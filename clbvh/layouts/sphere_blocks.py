"""The spheres of a tree's leaves as each layout stores them, and the device's arrays of a tree over spheres.

A sphere of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes. The nodes are those of
any tree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry import Spheres
from ..structs import BVH2_NODE, LAYOUT_WIDTHS, NO_PRIM, SPHERE, SPHERE_BLOCKS
from ..support.compiled import compiled
from .bvh2 import make_bvh2_nodes
from .device_arrays import DeviceArrays
from .wide import WideTree, widen

# As of `choose_children`, for blocks of spheres.
_BLOCK_COST = 1.0
_BLOCK_PRICE = 16.0


def make_sphere_arrays(spheres: Spheres, bvh: Bvh, layout: str) -> DeviceArrays:
    """Return a tree over spheres in the layout of that name.

    Parameters
    ----------
    spheres : Spheres
    bvh : Bvh
        Over the boxes of these spheres, see `builders.build.build_over`.
    layout : str
        One of `structs.LAYOUT_WIDTHS`.

    Returns
    -------
    DeviceArrays
        The blocks are `structs.SPHERE`, or `structs.SPHERE_BLOCKS` in the wide layouts.
    """
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        return DeviceArrays(make_bvh2_nodes(bvh), gather_spheres(spheres, bvh.prim_ids), bvh.depth)
    tree = _widen(bvh, width)
    # An entry point, see cl/traversal/entry_point.cl, can push up to width - 1 children that a descent from the root
    # would not push.
    return DeviceArrays(tree.nodes, gather_sphere_blocks(spheres, tree.blocks), tree.stack_size + width - 1)


def measure_sphere_bytes(bvh: Bvh, layout: str) -> int:
    """Return the size of the arrays; the blocks are only counted, not made."""
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        # A tree of one leaf still has one node on the device.
        return max(1, bvh.node_count // 2) * BVH2_NODE.itemsize + len(bvh.prim_ids) * SPHERE.itemsize
    tree = _widen(bvh, width)
    return int(tree.nodes.nbytes) + len(tree.blocks) * SPHERE_BLOCKS[width].itemsize


def gather_spheres(spheres: Spheres, prim_ids: NDArray[np.int32]) -> NDArray[np.void]:
    """Return spheres in the given order.

    Parameters
    ----------
    spheres : Spheres
    prim_ids : (n,) int32
        Indices of spheres: a tree's `prim_ids`, or all spheres in order.

    Returns
    -------
    (n,) `structs.SPHERE`
    """
    return _gather(spheres, prim_ids.reshape(-1, 1), SPHERE)


def gather_sphere_blocks(spheres: Spheres, blocks: NDArray[np.int32]) -> NDArray[np.void]:
    """Return the spheres of each block.

    Parameters
    ----------
    spheres : Spheres
    blocks : (G, width) int32
        Of a `WideTree` over the spheres.

    Returns
    -------
    (G,) `structs.SPHERE_BLOCKS[width]`
        Lanes without a sphere are NaN.
    """
    return _gather(spheres, blocks, SPHERE_BLOCKS[blocks.shape[1]])


def _widen(bvh: Bvh, width: int) -> WideTree:
    return widen(bvh, width, block_cost=_BLOCK_COST, block_price=_BLOCK_PRICE)


def _gather(spheres: Spheres, blocks: NDArray[np.int32], struct: np.dtype) -> NDArray[np.void]:
    """Return one struct for each row of blocks."""
    gathered = np.empty(len(blocks), struct)
    lanes = gathered.view(np.float32).reshape(len(blocks), -1)
    _gather_lanes(spheres.local_centres, spheres.local_radii, blocks, lanes, lanes.view(np.int32))
    return gathered


@compiled
def _gather_lanes(centres, radii, blocks, lanes, lane_ints):
    width = blocks.shape[1]
    first_radius, first_prim_id = 3 * width, 4 * width
    for block in range(len(blocks)):
        for slot in range(width):
            prim = blocks[block, slot]
            lane_ints[block, first_prim_id + slot] = prim
            is_missing = prim == NO_PRIM
            for axis in range(3):
                lanes[block, axis * width + slot] = np.nan if is_missing else centres[prim, axis]
            lanes[block, first_radius + slot] = np.nan if is_missing else radii[prim]

"""The spheres of the leaves, as each layout stores them.

A sphere of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Spheres
from ..geometry.box_mesh import bound_sphere, sphere_reach
from ..structs import BOX_NEGATED_MAX, NO_PRIM, SPHERE, SPHERE_BLOCKS
from ..support.compiled import compiled


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


def _gather(spheres: Spheres, blocks: NDArray[np.int32], struct: np.dtype) -> NDArray[np.void]:
    """Return one struct for each row of blocks."""
    gathered = np.empty(len(blocks), struct)
    lanes = gathered.view(np.float32).reshape(len(blocks), -1)
    _gather_lanes(spheres.local_centres, spheres.local_radii, blocks, lanes, lanes.view(np.int32))
    return gathered


@compiled
def _gather_lanes(centres, radii, blocks, lanes, lane_ints):
    width = blocks.shape[1]
    for block in range(len(blocks)):
        for slot in range(width):
            _write_sphere(centres, radii, blocks[block, slot], lanes, lane_ints, block, slot, width)


@compiled
def _write_sphere(centres, radii, prim, lanes, lane_ints, block, slot, width):
    """Write one lane of a block."""
    is_missing = prim == NO_PRIM
    for axis in range(3):
        lanes[block, axis * width + slot] = np.nan if is_missing else centres[prim, axis]
    lanes[block, 3 * width + slot] = np.nan if is_missing else radii[prim]
    lane_ints[block, 4 * width + slot] = prim


@compiled
def write_sphere_leaves(centres, radii, leaves, prims, lanes, lane_ints, boxes):
    """Write the blocks of each leaf, and the box around its spheres; see `RefitArrays`.

    Parameters
    ----------
    centres, radii : (n, 3) and (n,) float32, local coordinates
    leaves : (L, 2) int32
    prims : (B, width) int32
    lanes, lane_ints : (B, 5 * width) float32 and int32, the same memory, written
    boxes : (L, 8) float32, written
        Rows of `geometry/boxes.py`.
    """
    width = prims.shape[1]
    zero, far = np.float32(0.0), np.float32(np.inf)
    for leaf in range(len(leaves)):
        for lane in range(boxes.shape[1]):
            boxes[leaf, lane] = far
        for block in range(leaves[leaf, 0], leaves[leaf, 1]):
            for slot in range(width):
                prim = prims[block, slot]
                _write_sphere(centres, radii, prim, lanes, lane_ints, block, slot, width)
                if prim == NO_PRIM:
                    continue
                reach = sphere_reach(radii[prim])
                for axis in range(3):
                    lower, upper = bound_sphere(centres[prim, axis], reach)
                    # Zero is added, because -0.0 would have other bytes.
                    boxes[leaf, axis] = min(boxes[leaf, axis], lower + zero)
                    boxes[leaf, BOX_NEGATED_MAX + axis] = min(boxes[leaf, BOX_NEGATED_MAX + axis], zero - upper)

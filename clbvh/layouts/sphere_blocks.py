"""The spheres of the leaves, as each layout stores them.

A sphere of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Spheres
from ..structs import NO_PRIM, SPHERE, SPHERE_BLOCKS
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
    first_radius, first_prim_id = 3 * width, 4 * width
    for block in range(len(blocks)):
        for slot in range(width):
            prim = blocks[block, slot]
            lane_ints[block, first_prim_id + slot] = prim
            is_missing = prim == NO_PRIM
            for axis in range(3):
                lanes[block, axis * width + slot] = np.nan if is_missing else centres[prim, axis]
            lanes[block, first_radius + slot] = np.nan if is_missing else radii[prim]

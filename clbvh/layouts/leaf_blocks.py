"""The triangles of the leaves, with their corners, and the spheres, as each layout stores them.

A primitive of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, Shape
from ..geometry.corners import Bounded
from ..structs import NO_PRIM, SPHERE, SPHERE_BLOCKS, TRIANGLE, TRIANGLE_BLOCKS
from ..support.compiled import compiled


def block_struct(shape: Bounded, width: int) -> np.dtype:
    """Return the struct of a block of `width` primitives of a shape."""
    return TRIANGLE_BLOCKS.get(width, TRIANGLE) if isinstance(shape, Mesh) else SPHERE_BLOCKS.get(width, SPHERE)


def gather_blocks(shape: Shape, blocks: NDArray[np.int32]) -> NDArray[np.void]:
    """Return the triangles or spheres of each block.

    Parameters
    ----------
    shape : Mesh or Spheres
    blocks : (G, width) int32
        Faces of the mesh, or spheres: of a `WideTree`, or one in each block, as `bvh2` has them.

    Returns
    -------
    (G,) `structs.TRIANGLE_BLOCKS[width]` or `structs.SPHERE_BLOCKS[width]`; with a width of 1 `TRIANGLE` or `SPHERE`
        Lanes without a primitive are NaN, and so are degenerate triangles, which in `TRIANGLE` have three equal
        corners.
    """
    struct = block_struct(shape, blocks.shape[1])
    gathered = np.empty(len(blocks), struct)
    lanes = gathered.view(np.float32).reshape(len(blocks), struct.itemsize // 4)
    written = blocks, lanes, lanes.view(np.int32)
    if isinstance(shape, Mesh):
        _gather_triangles(shape.local_vertices, shape.faces, shape.degenerate_faces, *written)
    else:
        _gather_spheres(shape.local_centres, shape.local_radii, *written)
    return gathered


@compiled
def _gather_triangles(vertices, faces, degenerate, blocks, lanes, lane_ints):
    width = blocks.shape[1]
    first_prim_id = 9 * width
    for block in range(len(blocks)):
        for slot in range(width):
            prim = blocks[block, slot]
            lane_ints[block, first_prim_id + slot] = prim
            is_degenerate = prim == NO_PRIM or degenerate[prim]
            is_nan = is_degenerate and width > 1
            for corner in range(3):
                for axis in range(3):
                    lane = (3 * corner + axis) * width + slot
                    source = 0 if is_degenerate else corner
                    lanes[block, lane] = np.nan if is_nan else vertices[faces[prim, source], axis]


@compiled
def _gather_spheres(centres, radii, blocks, lanes, lane_ints):
    width = blocks.shape[1]
    for block in range(len(blocks)):
        for slot in range(width):
            prim = blocks[block, slot]
            is_missing = prim == NO_PRIM
            for axis in range(3):
                lanes[block, axis * width + slot] = np.nan if is_missing else centres[prim, axis]
            lanes[block, 3 * width + slot] = np.nan if is_missing else radii[prim]
            lane_ints[block, 4 * width + slot] = prim

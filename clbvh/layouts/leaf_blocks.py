"""The triangles of the leaves, with their corners, as each layout stores them.

A triangle of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..structs import NO_PRIM, TRIANGLE, TRIANGLE_BLOCKS, TRIANGLE_LANES
from ..support.compiled import compiled

# For faces whose numbers on the device are their indices.
_NO_NUMBERS = np.empty(0, np.int32)


class FaceNumbers(NamedTuple):
    """The faces of a mesh as the device knows them, where that differs from the mesh.

    Attributes
    ----------
    numbers : (F,) int32, not negative
        In place of the indices of the faces; the order of both is the same.
    is_degenerate : (F,) bool
        Faces that no ray hits, in place of `Mesh.degenerate_faces`.
    """

    numbers: NDArray[np.int32]
    is_degenerate: NDArray[np.bool_]


def gather_triangles(
    mesh: Mesh, prim_ids: NDArray[np.int32], face_numbers: FaceNumbers | None = None
) -> NDArray[np.void]:
    """Return the mesh's triangles in the given order, each with its corners.

    Parameters
    ----------
    mesh : Mesh
    prim_ids : (n,) int32
        Faces of the mesh: a tree's `prim_ids`, or all faces in order.
    face_numbers : FaceNumbers, optional

    Returns
    -------
    (n,) `structs.TRIANGLE`
        Degenerate triangles have three equal corners.
    """
    triangles: NDArray[Any] = np.empty((len(prim_ids), TRIANGLE_LANES), np.float32)
    _gather(mesh, prim_ids.reshape(-1, 1), face_numbers, triangles, nan_if_degenerate=False)
    return triangles.view(TRIANGLE).reshape(-1)


def gather_blocks(mesh: Mesh, blocks: NDArray[np.int32], face_numbers: FaceNumbers | None = None) -> NDArray[np.void]:
    """Return the corners of the triangles of each block.

    Parameters
    ----------
    mesh : Mesh
    blocks : (G, width) int32
        Of a `WideTree` over the mesh.
    face_numbers : FaceNumbers, optional

    Returns
    -------
    (G,) `structs.TRIANGLE_BLOCKS[width]`
        Degenerate triangles and lanes without a triangle are NaN.
    """
    triangle_blocks = np.empty(len(blocks), TRIANGLE_BLOCKS[blocks.shape[1]])
    lanes = triangle_blocks.view(np.float32).reshape(len(blocks), -1)
    _gather(mesh, blocks, face_numbers, lanes, nan_if_degenerate=True)
    return triangle_blocks


def _gather(
    mesh: Mesh,
    blocks: NDArray[np.int32],
    face_numbers: FaceNumbers | None,
    lanes: NDArray[np.float32],
    *,
    nan_if_degenerate: bool,
) -> None:
    """Write the corners and numbers of the triangles of each block into the lanes of the blocks' structs."""
    numbers, degenerate = face_numbers or (_NO_NUMBERS, mesh.degenerate_faces)
    _gather_lanes(
        mesh.local_vertices, mesh.faces, degenerate, numbers, blocks, nan_if_degenerate, lanes, lanes.view(np.int32)
    )


@compiled
def _gather_lanes(vertices, faces, degenerate, numbers, blocks, nan_if_degenerate, lanes, lane_ints):
    width = blocks.shape[1]
    first_prim_id = 9 * width
    for block in range(len(blocks)):
        for slot in range(width):
            prim = blocks[block, slot]
            lane_ints[block, first_prim_id + slot] = prim if prim == NO_PRIM or len(numbers) == 0 else numbers[prim]
            is_degenerate = prim == NO_PRIM or degenerate[prim]
            is_nan = is_degenerate and nan_if_degenerate
            for corner in range(3):
                for axis in range(3):
                    lane = (3 * corner + axis) * width + slot
                    source = 0 if is_degenerate else corner
                    lanes[block, lane] = np.nan if is_nan else vertices[faces[prim, source], axis]

"""The triangles of the leaves, with their corners, and the spheres, as each layout stores them.

A primitive of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, Spheres
from ..geometry.box_mesh import bound_sphere, sphere_reach
from ..structs import BOX_NEGATED_MAX, NO_PRIM, SPHERE, SPHERE_BLOCKS, TRIANGLE, TRIANGLE_BLOCKS, TRIANGLE_LANES
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
    return _gather_some_spheres(spheres, prim_ids.reshape(-1, 1), SPHERE)


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
    return _gather_some_spheres(spheres, blocks, SPHERE_BLOCKS[blocks.shape[1]])


def _gather_some_spheres(spheres: Spheres, blocks: NDArray[np.int32], struct: np.dtype) -> NDArray[np.void]:
    """Return one struct for each row of blocks."""
    gathered = np.empty(len(blocks), struct)
    lanes = gathered.view(np.float32).reshape(len(blocks), -1)
    _gather_sphere_lanes(spheres.local_centres, spheres.local_radii, blocks, lanes, lanes.view(np.int32))
    return gathered


@compiled
def _gather_sphere_lanes(centres, radii, blocks, lanes, lane_ints):
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

"""The parts of a file: its meshes, and the nodes that place them. The readers of formats that have parts make them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..appearance.appearance import Appearance


class FileMesh(NamedTuple):
    """A mesh as the file has it, (V, 3) float and (F, 3) int, and its looks. The name may be empty.

    Where the file has no normals and declares faces flat, `flat_faces` is (F,) bool.
    """

    name: str
    vertices: NDArray[np.number]
    faces: NDArray[np.integer]
    appearance: Appearance | None = None
    flat_faces: NDArray[np.bool_] | None = None


class FileNode(NamedTuple):
    """A mesh, by its index, at a position that a (4, 4) float64 matrix gives. The name may be empty."""

    name: str
    mesh: int
    matrix: NDArray[np.float64]


class FileParts(NamedTuple):
    """The meshes that the nodes place, and the nodes, both in the order of the file."""

    meshes: list[FileMesh]
    nodes: list[FileNode]


def drop_loose_vertices(
    vertices: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices that faces refer to, in their order, and the faces with the new indices."""
    used, renumbered = np.unique(faces, return_inverse=True)
    if len(used) == len(vertices):
        return vertices, faces
    return vertices[used], renumbered.reshape(faces.shape)

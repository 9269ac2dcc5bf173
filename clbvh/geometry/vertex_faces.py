"""The faces around each vertex, where vertices in one place count as one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh


class VertexFaces(NamedTuple):
    """Faces around vertices, for compiled functions.

    Attributes
    ----------
    place : (V,) int64
        The place of each vertex: vertices of equal coordinates share one, as in files that repeat them per face.
    begin : (P + 1,) int64
        The faces at place p are ``faces[begin[p] : begin[p + 1]]``.
    faces : (3 F,) int64
        Ascending at each place; a face with two corners in one place is there twice.
    """

    place: NDArray[np.int64]
    begin: NDArray[np.int64]
    faces: NDArray[np.int64]


def find_vertex_faces(mesh: Mesh) -> VertexFaces:
    """Return the faces around each vertex of a mesh, in O(V log V + F log F)."""
    # Zero and minus zero are one place.
    order = np.lexsort((mesh.vertices + 0.0).T)
    ordered = mesh.vertices[order]
    is_new = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]
    place = np.empty(len(order), np.int64)
    place[order] = np.cumsum(is_new) - 1
    corners = place[mesh.faces].reshape(-1)
    faces = np.argsort(corners, kind="stable") // 3
    begin = np.concatenate(([0], np.cumsum(np.bincount(corners, minlength=int(is_new.sum())))))
    return VertexFaces(place, begin, faces)

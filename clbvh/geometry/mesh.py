"""A triangle mesh in memory, checked and re-based.

Owns the check of vertices and faces and the move to local coordinates. Knows nothing of files or trees.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MeshError

# A tree over n primitives has up to 2n - 1 nodes, and both are counted in int32.
MAX_FACE_COUNT = 2**30

# Faces looked at together where many arrays of them are needed: they stay in the cache, which is three times as fast
# for 871,306 faces on a 2-core x86-64 server, and the memory does not grow with the mesh.
_CHUNK_FACES = 1 << 14


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with float32 coordinates relative to an origin in float64.

    Scans in survey coordinates lie millions of units from zero, where float32 resolves half a unit. The vertices
    are therefore moved to the centre of their box in float64 before they are rounded to float32.

    Attributes
    ----------
    vertices : (V, 3) float32, object units, relative to `origin`
    faces : (F, 3) int32, vertex indices
        Face i of the file (after polygons are cut into triangles, in place) is row i.
    origin : (3,) float64, object units
        Centre of the vertices' box in the file's coordinates.
    name : str
        What messages and reports call the mesh.

    Notes
    -----
    Build one with `Mesh.from_arrays` or `clbvh.load_mesh`: they check what the constructor takes for granted.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    origin: NDArray[np.float64]
    name: str = field(default="mesh")

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, faces: ArrayLike, *, name: str = "mesh") -> Mesh:
        """Check the arrays and re-base the vertices.

        Parameters
        ----------
        vertices : (V, 3) float, object units
            Any floating-point or integer dtype; not modified.
        faces : (F, 3) int
            Vertex indices from 0 to V - 1; not modified.
        name : str, optional
            What messages and reports call the mesh.

        Returns
        -------
        Mesh

        Raises
        ------
        MeshError
            Wrong shape or dtype, no faces, too many faces, a NaN or infinite coordinate, or a vertex index out of
            range; the message names the first offender.
        """
        checked_vertices = _check_vertices(vertices, name)
        checked_faces = _check_faces(faces, len(checked_vertices), name)

        # The box is taken in the input's own precision, the centre and the subtraction in float64.
        lower = checked_vertices.min(axis=0).astype(np.float64)
        upper = checked_vertices.max(axis=0).astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is refused below
            origin = lower + (upper - lower) / 2
            local = np.subtract(checked_vertices, origin, dtype=np.float64).astype(np.float32)
        if not np.isfinite(local).all():
            width = 2 * float(np.max(upper / 2 - lower / 2))
            raise MeshError(
                f"{name}: the mesh is {width:.3g} units wide, more than float32 can hold: give it in a larger unit"
            )
        return cls(local, checked_faces, origin, name)

    @property
    def face_count(self) -> int:
        """Number of triangles, degenerate ones included."""
        return len(self.faces)

    @cached_property
    def degenerate_faces(self) -> NDArray[np.bool_]:
        """(F,) bool: true for triangles whose three corners lie on one line or in one point.

        Such a triangle stays in the mesh, so that face numbers keep their meaning, but no ray ever hits it.
        """
        degenerate = np.empty(self.face_count, dtype=np.bool_)
        for begin in range(0, self.face_count, _CHUNK_FACES):
            end = begin + _CHUNK_FACES
            a, b, c = (self.vertices[self.faces[begin:end, corner]].T.astype(np.float64) for corner in range(3))
            (ux, uy, uz), (vx, vy, vz) = b - a, c - a
            # Differences of float32 values and their products fit float64, so collinear means equal products.
            degenerate[begin:end] = (uy * vz == uz * vy) & (uz * vx == ux * vz) & (ux * vy == uy * vx)
        return degenerate

    @property
    def degenerate_count(self) -> int:
        """Number of triangles without area."""
        return int(self.degenerate_faces.sum())

    def __repr__(self) -> str:
        return f"Mesh({self.name!r}, vertices={len(self.vertices):,}, faces={self.face_count:,})"


def _check_vertices(vertices: ArrayLike, name: str) -> NDArray[np.floating]:
    """Return the vertices as a finite (V, 3) float array, without a copy where possible."""
    array = np.asarray(vertices)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name}: vertices must have shape (V, 3), not {array.shape}")
    if not np.issubdtype(array.dtype, np.floating):
        if not np.issubdtype(array.dtype, np.integer):
            raise MeshError(f"{name}: vertices must be numbers, not {array.dtype}")
        array = array.astype(np.float64)
    if len(array) == 0:
        raise MeshError(f"{name}: the mesh has no vertices")
    finite = np.isfinite(array)
    if not finite.all():
        row, axis = np.argwhere(~finite)[0]
        raise MeshError(f"{name}: vertex {row} has a coordinate that is not finite: {'xyz'[axis]} = {array[row, axis]}")
    return array


def _check_faces(faces: ArrayLike, vertex_count: int, name: str) -> NDArray[np.int32]:
    """Return the faces as an (F, 3) int32 array whose indices all name a vertex."""
    array = np.asarray(faces)
    if array.size == 0:
        raise MeshError(f"{name}: the mesh has no faces")
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name}: faces must have shape (F, 3), not {array.shape}")
    if not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{name}: faces must be integers, not {array.dtype}")
    if len(array) > MAX_FACE_COUNT:
        raise MeshError(f"{name}: the mesh has {len(array):,} faces; the limit is {MAX_FACE_COUNT:,}")
    if array.min() < 0 or array.max() >= vertex_count:
        row, corner = np.argwhere((array < 0) | (array >= vertex_count))[0]
        raise MeshError(
            f"{name}: face {row} refers to vertex {array[row, corner]}, but there are {vertex_count} vertices "
            f"(0 to {vertex_count - 1})"
        )
    return np.ascontiguousarray(array, dtype=np.int32)

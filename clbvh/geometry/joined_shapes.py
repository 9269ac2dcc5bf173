"""The arrays of many small shapes joined, for compiled loops over all of them.

Owns which shapes are small. A call from Python for each of thousands of shapes takes longer than the work on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh
from .spheres import Bounded

# Of a small shape. The calls for one take 0.1 ms, a tree over this many triangles and its arrays 0.9.
MOST_PRIMS = 1 << 12

# Of shapes that are joined. Fewer take 2 ms one by one, and their trees can be kept in a cache.
_LEAST_SHAPES = 16

# Of all shapes that are joined at a time: the copies of their corners take up to 50 MB.
_MOST_JOINED = 1 << 20


class JoinedCorners(NamedTuple):
    """The corners of n shapes, as `corners.Corners` has those of one.

    Attributes
    ----------
    points : (m, 3) float32
        In the local coordinates of each shape.
    ids : (k, 3) int32
        The points of each primitive, by their numbers in its shape.
    first_points, first_prims : (n + 1,) int64
        Where the points and the primitives of each shape begin, and those of the last one end.
    """

    points: NDArray[np.float32]
    ids: NDArray[np.int32]
    first_points: NDArray[np.int64]
    first_prims: NDArray[np.int64]

    @classmethod
    def of(cls, shapes: Sequence[Bounded]) -> Self:
        """Join the corners of shapes."""
        points, ids = zip(*(shape.find_corners() for shape in shapes), strict=True)
        return cls(np.concatenate(points), np.concatenate(ids), first_rows(points), first_rows(ids))


class JoinedMeshes(NamedTuple):
    """The triangles of n meshes.

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int32
        Rows of `vertices`.
    owners : (V,) int64
        The mesh of each vertex.
    scales : (n,) float64
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    owners: NDArray[np.int64]
    scales: NDArray[np.float64]

    @classmethod
    def of(cls, meshes: Sequence[Mesh]) -> Self:
        """Join the triangles of meshes."""
        vertices, faces = [mesh.vertices for mesh in meshes], [mesh.faces for mesh in meshes]
        first = first_rows(vertices)
        shifts = np.repeat(first[:-1].astype(np.int32), [len(each) for each in faces])
        return cls(
            np.concatenate(vertices),
            np.concatenate(faces) + shifts[:, None],
            np.repeat(np.arange(len(meshes)), np.diff(first)),
            np.array([mesh.scale for mesh in meshes]),
        )


def first_rows(arrays: Sequence[NDArray]) -> NDArray[np.int64]:
    """Return where each of n arrays begins when they follow each other, and the end: (n + 1,) int64."""
    return np.cumsum([0, *map(len, arrays)])


def batch_small(shapes: Sequence[Bounded]) -> list[list[int]]:
    """Return the numbers of small shapes, in batches of one kind of shapes that are small enough to be joined.

    A shape without enough others is in no batch.
    """
    batches: dict[tuple[type, int], list[int]] = {}
    total = 0
    for number, shape in enumerate(shapes):
        if shape.prim_count <= MOST_PRIMS:
            total += shape.prim_count
            batches.setdefault((type(shape), total // _MOST_JOINED), []).append(number)
    return [batch for batch in batches.values() if len(batch) >= _LEAST_SHAPES]

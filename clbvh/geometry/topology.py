"""What the vertices of a mesh share: equal points, normals at them, and whether the faces enclose a volume."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from ..errors import MeshError

# Odd numbers without a pattern.
FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5], np.uint64)


# An edge is two indices in 64 bits; this many bits are the larger one.
INDEX_BITS = 32

NORMALS = Loops("geometry/normals")

_MOST_CORNERS = np.iinfo(np.int32).max


class EqualPoints(NamedTuple):
    """Groups of points whose coordinates have the same bits.

    Attributes
    ----------
    first : (P,) int64
        The first point of each group, ascending.
    ids : (n,) int64
        The group of each point.
    """

    first: NDArray[np.int64]
    ids: NDArray[np.int64]


def find_equal_points(points: NDArray[Any]) -> EqualPoints:
    """Find the groups of equal points among (n, 3) float32, float64 or int64, or (n, 4), in O(n log n).

    0.0 and -0.0 differ.
    """
    if len(points) == 0:
        return EqualPoints(np.empty(0, np.int64), np.empty(0, np.int64))
    order, is_new = _sort(np.ascontiguousarray(points).view(f"u{points.itemsize}"))
    first = np.minimum.reduceat(order, np.flatnonzero(is_new))
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    ids = np.empty(len(points), np.int64)
    ids[order] = rank[np.cumsum(is_new) - 1]
    return EqualPoints(np.sort(first), ids)


def _sort(bits: NDArray[np.unsignedinteger]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return an order in which equal rows are neighbours, and where one differs from the row before."""
    # One key is sorted ten times as fast as three.
    keys = _find_keys(bits)
    order = np.argsort(keys)
    is_new = _differ_from_before(bits[order])
    if (is_new != _differ_from_before(keys[order][:, None])).any():
        # Different points with the same key: a forged file has them, no other one does.
        order = np.lexsort(bits.T)
        is_new = _differ_from_before(bits[order])
    return order, is_new


def _find_keys(bits: NDArray[np.unsignedinteger]) -> NDArray[np.uint64]:
    wide = bits.astype(np.uint64)
    # Doubles that were floats end with zeros, which no product would mix.
    folded = wide ^ (wide >> np.uint64(32))
    return np.asarray((folded * FACTORS[: bits.shape[1]]).sum(axis=1, dtype=np.uint64))


def _differ_from_before(rows: NDArray[np.unsignedinteger]) -> NDArray[np.bool_]:
    is_new = np.ones(len(rows), np.bool_)
    is_new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return is_new


def find_points(vertices: NDArray[np.floating]) -> EqualPoints:
    """Find the vertices with equal coordinates among (V, 3) or (V, 4), whatever the sign of their zeros."""
    return find_equal_points(vertices + 0.0)


class CornerFaces(NamedTuple):
    """The faces around each vertex of a mesh. Vertices with equal coordinates are one point.

    Attributes
    ----------
    points : (V,) int32
        The point of each vertex.
    begins : (P + 1,) int32
        Where the corners of each point begin, and where those of the last one end.
    faces : (3 F,) int32
        The face of each corner, by points, ascending for each; one with two corners at a point is there twice.
    """

    points: NDArray[np.int32]
    begins: NDArray[np.int32]
    faces: NDArray[np.int32]

    def widened(self) -> tuple[NDArray[np.int64], ...]:
        """Return the same for loops that take int64."""
        return tuple(each.astype(np.int64) for each in self)


def find_corner_faces(points: EqualPoints, faces: NDArray[np.int32]) -> CornerFaces:
    """Find the faces around each point of a mesh, in O(V + F).

    Raises
    ------
    MeshError
        There are more corners than int32 counts.
    """
    if faces.size > _MOST_CORNERS:
        raise MeshError(f"{len(faces):,} faces have more corners than are counted here: the limit is {_MOST_CORNERS:,}")
    ids, corner_faces = points.ids.astype(np.int32), np.empty(faces.size, np.int32)
    ends = np.zeros(len(points.first) + 1, np.int32)
    NORMALS.sort_corners(ids, faces, ends, corner_faces)
    return CornerFaces(ids, ends, corner_faces)


# The sum of unit vectors is no direction if it is shorter than this share of their weights: they cancel each other.
_LEAST_SHARE = 2.0**-40


def find_vertex_normals(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], scale: float, repeated: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return (V, 3) float64: unit normals at the vertices; see `Mesh.vertex_normals`.

    The angle makes the normal independent of how a surface is cut into triangles: Thürmer and Wüthrich, "Computing
    vertex normals from polygonal facets", 1998. O(V log V + F), one after the other in the order of the faces.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int32
    scale : float
        A power of two that brings the mesh to a size of about 1.
    repeated : (n,) int64
        Faces that do not count.
    """
    first, point_ids = find_points(vertices)
    face_normals, angles = np.empty((len(faces), 3)), np.empty((len(faces), 3))
    NORMALS.measure_faces(vertices, faces, scale, 0, len(faces), face_normals, angles)
    angles[repeated] = 0.0
    corners, flat_angles = point_ids[faces], angles.ravel()
    weighted = (angles[..., None] * face_normals[:, None]).reshape(-1, 3)
    sums = np.stack([np.bincount(corners.ravel(), weights, len(first)) for weights in weighted.T], axis=1)
    lengths = np.sqrt(np.einsum("ij,ij->i", sums, sums))
    cancels = ~(lengths > _LEAST_SHARE * np.bincount(corners.ravel(), flat_angles, len(first)))
    lengths[cancels] = np.nan
    normals = sums / lengths[:, None]
    if cancels.any():
        # Of the face with the widest angle there, the first of equal ones.
        slots = np.flatnonzero(cancels[corners].ravel() & (flat_angles > 0))
        slots = slots[np.argsort(-flat_angles[slots], kind="stable")]
        points, widest = np.unique(corners.ravel()[slots], return_index=True)
        normals[points] = face_normals[slots[widest] // 3]
        _take_neighbours(corners[np.isnan(normals[corners, 0]).any(axis=1)], normals)
    return normals[point_ids]


def _take_neighbours(corners: NDArray[np.int64], normals: NDArray[np.float64]) -> None:
    """Give points without a normal that of another corner of their faces, from face to face, as far as there is one."""
    while len(corners):
        has_none = np.isnan(normals[corners, 0])
        is_next = has_none.any(axis=1) & ~has_none.all(axis=1)
        if not is_next.any():
            return
        rows = np.flatnonzero(is_next)
        givers = corners[rows, has_none[rows].argmin(axis=1)]
        normals[corners[rows, has_none[rows].argmax(axis=1)]] = normals[givers]
        corners = corners[has_none.any(axis=1)]


def is_closed(faces: NDArray[np.integer]) -> bool:
    """Return whether every edge between two indices belongs to an even number of triangles, in O(F log F).

    Parameters
    ----------
    faces : (F, 3) int
        Indices of vertices, or of points. An edge between equal ones counts for nothing.
    """
    begins = faces.astype(np.int64)
    ends = np.roll(begins, -1, axis=1)
    edges = np.sort((np.minimum(begins, ends) << INDEX_BITS | np.maximum(begins, ends))[begins != ends])
    # Equal edges are neighbours now, and are pairs if there is an even number of each.
    return len(edges) % 2 == 0 and bool((edges[::2] == edges[1::2]).all())

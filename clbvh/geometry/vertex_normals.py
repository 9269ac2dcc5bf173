"""Normals at the vertices of a mesh: those of the faces around each, weighted by their angles there.

The angle makes the normal independent of how a surface is cut into triangles: a corner of a cube has the same one
whether its sides are cut along one diagonal or the other. Thürmer and Wüthrich, "Computing vertex normals from
polygonal facets", 1998.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..support.compiled import compiled
from .corners import measure_corner
from .equal_points import find_points

# The sum of unit vectors is no direction if it is shorter than this share of their weights: they cancel each other.
_LEAST_SHARE = 2.0**-40


def find_vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int32], scale: float) -> NDArray[np.float64]:
    """Return (V, 3) float64: unit normals at the vertices; see `Mesh.vertex_normals`.

    O(V log V + F), one after the other in the order of the faces.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int32
    scale : float
        A power of two that brings the mesh to a size of about 1.
    """
    first, point_ids = find_points(vertices)
    sums = np.zeros((len(first), 4))
    _add_normals(vertices, faces, scale, point_ids, sums)
    _normalize(sums)
    return sums[point_ids, :3]


@compiled(error_model="numpy")
def _add_normals(vertices, faces, scale, point_ids, sums):
    """Add each face's unit normal, times its angle, and the angle, to the points of its corners."""
    for face in range(len(faces)):
        for corner in range(3):
            nx, ny, nz, length, angle = measure_corner(vertices, faces, scale, face, corner)
            if length > 0.0:
                point = point_ids[faces[face, corner]]
                sums[point, 0] += angle * nx / length
                sums[point, 1] += angle * ny / length
                sums[point, 2] += angle * nz / length
                sums[point, 3] += angle


@compiled(error_model="numpy")
def _normalize(sums):
    for point in range(len(sums)):
        x, y, z = sums[point, 0], sums[point, 1], sums[point, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if not length > _LEAST_SHARE * sums[point, 3]:
            length = np.nan
        sums[point, 0], sums[point, 1], sums[point, 2] = x / length, y / length, z / length

"""Polygons to triangles: a polygon of m corners is replaced by m - 2 triangles in the order of the faces.

Faces with fewer than three corners are edges and points that an exporter left behind; they have no surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face_limit import check_face_count
from .problems import Problems


def count_triangles(sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the number of triangles of each polygon, (p,), of its number of corners."""
    return np.maximum(sizes.astype(np.int64) - 2, 0)


def report_edges(sizes: NDArray[np.integer], problems: Problems) -> None:
    """Say how many polygons of these numbers of corners have no triangle."""
    if edge_count := np.count_nonzero(sizes < 3):
        problems.add(f"{edge_count:,} of {len(sizes):,} faces have fewer than three corners, and are left out")


def cut_fans(corners: NDArray[np.integer], sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Cut polygons into fans around their first corners.

    A fan covers a convex polygon exactly. It reaches out of a concave one, unless the first corner is the concave one.

    Parameters
    ----------
    corners : (n,) int
        Vertex indices of all polygons, concatenated.
    sizes : (p,) int
        Corners per polygon.

    Returns
    -------
    (F, 3) int
        Triangles in the order of the polygons, with their winding. Polygons with fewer than three corners have none.

    Raises
    ------
    MeshError
        The triangles do not fit the memory: a large polygon has hardly more corners than triangles, and a corner may
        be one byte of a file.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    triangle_counts = count_triangles(sizes)
    check_face_count(int(triangle_counts.sum()))
    # Triangle k of a polygon has its corners 0, k + 1 and k + 2.
    first = np.repeat(np.cumsum(sizes) - sizes, triangle_counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangle_counts) - triangle_counts, triangle_counts)
    return corners[np.column_stack((first, first + step + 1, first + step + 2))]

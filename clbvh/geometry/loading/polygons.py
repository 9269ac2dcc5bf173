"""Polygons to triangles: a polygon of m corners is replaced by m - 2 triangles in the order of the faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..face_limit import check_face_count


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
        Triangles in the order of the polygons, with their winding.

    Raises
    ------
    MeshError
        A polygon has fewer than three corners; the message names the first such face, from 0. Or the triangles do not
        fit the memory: a large polygon has hardly more corners than triangles, and a corner may be one byte of a file.
    """
    if len(sizes) and sizes.min() < 3:
        face = int(np.argmax(sizes < 3))
        raise MeshError(f"face {face} has {sizes[face]} corners, but a face has at least 3")
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    check_face_count(len(corners) - 2 * len(sizes))
    # Triangle k of a polygon has its corners 0, k + 1 and k + 2.
    triangle_counts = sizes - 2
    first = np.repeat(np.cumsum(sizes) - sizes, triangle_counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangle_counts) - triangle_counts, triangle_counts)
    return corners[np.column_stack((first, first + step + 1, first + step + 2))]

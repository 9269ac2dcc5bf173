"""Polygons to triangles, in place: a polygon of m corners becomes m - 2 triangles, where it stood.

Owns the check of a file's faces and the cut. Knows nothing of file formats.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError


def cut_polygons(
    vertices: NDArray[np.floating],
    corners: NDArray[np.number],
    sizes: NDArray[np.integer],
    *,
    source: str,
    first_index: int = 0,
) -> NDArray[np.int32]:
    """Check the polygons of a file and cut them into triangles.

    Parameters
    ----------
    vertices : (V, 3) float, object units
        Where the corners lie: a polygon with a dent is cut so that no triangle leaves it.
    corners : (n,) int or float
        Vertex indices of all polygons, one after the other; float, where they come from text.
    sizes : (p,) int
        Corners per polygon.
    source : str
        What messages call the file.
    first_index : int, optional
        What the file calls its first vertex; for messages.

    Returns
    -------
    (F, 3) int32
        Triangles in the order of the polygons, wound like them.

    Raises
    ------
    MeshError
        Fewer than three corners, or an index that is no vertex; the message names the first such face, from 0.
    """
    _check_polygons(corners, sizes, len(vertices), source, first_index)
    indices = corners.astype(np.int32)
    if (sizes == 3).all():
        return indices.reshape(-1, 3)

    # Triangle k of a polygon is a fan around its first corner: 0, k + 1, k + 2.
    triangle_counts = sizes - 2
    first_corners = np.cumsum(sizes) - sizes
    polygon_ids = np.repeat(np.arange(len(sizes)), triangle_counts)
    first_triangles = np.cumsum(triangle_counts) - triangle_counts
    base = first_corners[polygon_ids]
    step = np.arange(len(polygon_ids)) - first_triangles[polygon_ids]
    faces = indices[np.column_stack((base, base + step + 1, base + step + 2))]

    # A fan leaves a polygon that has a dent: some of its triangles then look the other way.
    for polygon in _find_dented(vertices, faces, polygon_ids, sizes):
        begin, size = first_corners[polygon], sizes[polygon]
        ring = indices[begin : begin + size]
        first = first_triangles[polygon]
        faces[first : first + size - 2] = ring[_clip_ears(vertices[ring].astype(np.float64))]
    return faces


def _check_polygons(
    corners: NDArray[np.number],
    sizes: NDArray[np.integer],
    vertex_count: int,
    source: str,
    first_index: int,
) -> None:
    if len(sizes) and sizes.min() < 3:
        face = int(np.argmax(sizes < 3))
        raise MeshError(f"{source}: face {face} has {sizes[face]} corners, but a face has at least 3")
    # The common case in three quick passes; written so that NaN fails it.
    in_range = len(corners) == 0 or (corners.min() >= 0 and corners.max() < vertex_count)
    if in_range and (corners.dtype.kind != "f" or (corners.astype(np.int32) == corners).all()):
        return
    valid = (corners >= 0) & (corners < vertex_count)
    valid &= np.floor(corners) == corners
    corner = int(np.argmin(valid))
    face = int(np.searchsorted(np.cumsum(sizes), corner, side="right"))
    raise MeshError(
        f"{source}: face {face} refers to vertex {corners[corner] + first_index:.15g}, but there are "
        f"{vertex_count} vertices ({first_index} to {vertex_count - 1 + first_index})"
    )


def _find_dented(
    vertices: NDArray[np.floating],
    faces: NDArray[np.int32],
    polygon_ids: NDArray[np.int64],
    sizes: NDArray[np.integer],
) -> NDArray[np.int64]:
    """Return the polygons whose fan has a triangle that looks away from the polygon's mean normal."""
    many = np.flatnonzero(sizes[polygon_ids] > 3)
    # Coordinates that are not finite, or overflow here, are refused later, and by name.
    with np.errstate(all="ignore"):
        a, b, c = (vertices[faces[many, corner]].astype(np.float64) for corner in range(3))
        normals = np.cross(b - a, c - a)
        starts = np.flatnonzero(np.diff(polygon_ids[many], prepend=-1))
        sums = np.add.reduceat(normals, starts, axis=0)
        lengths = np.diff(np.append(starts, len(many)))
        away = np.einsum("ij,ij->i", normals, np.repeat(sums, lengths, axis=0)) < 0
    return np.unique(polygon_ids[many][away])


def _clip_ears(ring: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cut a polygon with a dent into triangles, one convex corner after the other.

    Parameters
    ----------
    ring : (m, 3) float64
        Corners in order.

    Returns
    -------
    (m - 2, 3) int64
        Positions in the ring. Quadratic to cubic in m, which is small.

    References
    ----------
    Gary Meisters, "Polygons Have Ears", 1975.
    """
    # Look at it along its mean normal: there it is a plane polygon that runs counter-clockwise.
    centred = ring - ring[0]
    normal = np.cross(centred[1:-1], centred[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    across, up = (axis + 1) % 3, (axis + 2) % 3
    flat = centred[:, (across, up)] if normal[axis] > 0 else centred[:, (up, across)]

    def turn(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    left = list(range(len(ring)))
    triangles = []
    while len(left) > 3:
        # A polygon that crosses itself may have no ear; then any corner has to do.
        chosen = 1
        for place in range(len(left)):
            a, b, c = left[place - 1], left[place], left[(place + 1) % len(left)]
            others = (p for p in left if p not in (a, b, c))
            if turn(a, b, c) > 0 and not any(
                turn(a, b, p) >= 0 and turn(b, c, p) >= 0 and turn(c, a, p) >= 0 for p in others
            ):
                chosen = place
                break
        triangles.append((left[chosen - 1], left[chosen], left[(chosen + 1) % len(left)]))
        del left[chosen]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles)

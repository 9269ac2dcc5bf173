"""Start points of rays that leave a surface: so far above it that the tracer cannot meet it again.

A point on a triangle, rounded to float32 in the tracer's local coordinates, may be on either side of the triangle that
the tracer has in float32, and the triangle test rounds as well. The distance is a bound on all these roundings, which
docs/internals/offsets.md derives.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import NO_PRIM
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import triangles_of
from .locations import make_normal

# Unit roundoffs of float32 and float64.
ROUNDING = 2.0**-24
DOUBLE_ROUNDING = 2.0**-53

# Roundings of float32 between a point and the t of a triangle, by docs/internals/offsets.md.
ROUNDINGS = 40


def find_offset_points(
    mesh: Mesh, prim_id: NDArray[np.int32], locations: NDArray[np.float64], is_front: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return (..., 3) float64, the file's coordinates: a point above each triangle; NaN without a face.

    Parameters
    ----------
    mesh : Mesh
    prim_id : (...) int32
    locations : (..., 3) float64, the file's coordinates
        Points on the triangles.
    is_front : (...) bool
        Whether the front is above, the side from which the corners run anticlockwise.
    """
    points = np.empty(locations.shape)
    flat, prims = points.reshape(-1, 3), np.ascontiguousarray(prim_id).reshape(-1)
    from_flat = np.ascontiguousarray(locations).reshape(-1, 3)
    fronts = np.ascontiguousarray(is_front).reshape(-1)

    def offset(begin: int, end: int) -> None:
        of_part = (values[begin:end] for values in (prims, from_flat, fronts, flat))
        _offset(triangles_of(mesh), mesh.local_vertices, mesh.origin, *of_part)

    with HostThreads() as threads:
        threads.for_ranges(len(flat), offset)
    return points


def find_sides(normals: NDArray[np.float64], directions: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return (...) bool: whether each direction leads to the side of its normal.

    Parameters
    ----------
    normals : (..., 3) float64
    directions : (..., 3) float
        Of any length; broadcast against the normals.
    """
    # The products of a tiny direction would underflow.
    longest = np.abs(directions).max(axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = np.einsum("...i,...i->...", directions / longest, normals)
    return np.asarray(heights >= 0.0)


@compiled(error_model="numpy")
def _offset(triangles, local_vertices, centre, prim_ids, locations, is_front, points):
    faces, scale = triangles.faces, triangles.scale
    normal, local = np.empty(3), np.empty(3)
    for hit in range(len(prim_ids)):
        prim = prim_ids[hit]
        if prim == NO_PRIM:
            points[hit, 0] = points[hit, 1] = points[hit, 2] = np.nan
            continue
        make_normal(triangles, prim, normal)
        if not is_front[hit]:
            normal[0], normal[1], normal[2] = -normal[0], -normal[1], -normal[2]
        # The point in the tracer's coordinates, and how far rounding can move it and the surface along the normal.
        reach, breadth, coarseness = 0.0, 0.0, 0.0
        for axis in range(3):
            local[axis] = (locations[hit, axis] - centre[axis]) * scale
            reach = max(reach, abs(local[axis]))
            breadth += abs(normal[axis])
            coarseness += abs(normal[axis]) * abs(locations[hit, axis]) * scale
        # The highest corner of the tracer's triangle above the point.
        highest = 0.0
        for corner in range(3):
            vertex, height = faces[prim, corner], 0.0
            for axis in range(3):
                height += (local_vertices[vertex, axis] - local[axis]) * normal[axis]
            highest = max(highest, height)
        distance = highest + ROUNDINGS * ROUNDING * (reach + 1.0) * breadth + 2 * DOUBLE_ROUNDING * coarseness
        for axis in range(3):
            points[hit, axis] = locations[hit, axis] + distance * normal[axis] / scale

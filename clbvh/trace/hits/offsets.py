"""Start points of rays that leave a surface: so far above it that the tracer cannot meet it again.

A point on a triangle, rounded to float32 in the tracer's local coordinates, may be on either side of the triangle that
the tracer has in float32, and the triangle test rounds as well. The bound on all of it, which is the distance here, is
derived in docs/internals/offsets.md.
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
_ROUNDING = 2.0**-24
_DOUBLE_ROUNDING = 2.0**-53

# Roundings of float32 between a point and the t of a triangle, by docs/internals/offsets.md.
_ROUNDINGS = 40

# A normal is not used if it tilts against the edges by more than this, in local units: sixteen roundings.
_MOST_TILT = 2.0**-20


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


def find_sides(mesh: Mesh, prim_id: NDArray[np.int32], directions: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return (...) bool: whether each direction leads to the front of its triangle.

    Parameters
    ----------
    mesh : Mesh
    prim_id : (...) int32
    directions : (..., 3) float
        Of any length; broadcast against the faces.
    """
    normals = np.empty((*prim_id.shape, 3))
    _find_lifts(triangles_of(mesh), np.ascontiguousarray(prim_id).reshape(-1), normals.reshape(-1, 3))
    # The products of a tiny direction would underflow.
    longest = np.abs(directions).max(axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = np.einsum("...i,...i->...", directions / longest, normals)
    return np.asarray(heights >= 0.0)


@compiled(error_model="numpy")
def _find_lift(triangles, prim, lift):
    """Write the unit vector along which points are lifted from a triangle to its front.

    It is the normal. A triangle so thin that float64 does not know its normal has any vector across its longest edge.
    """
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    make_normal(triangles, prim, lift)
    tilt, longest, longest_corner = 0.0, -1.0, 0
    for corner in range(3):
        begin, end = faces[prim, corner], faces[prim, (corner + 1) % 3]
        along, square = 0.0, 0.0
        for axis in range(3):
            edge = (vertices[end, axis] - vertices[begin, axis]) * scale
            along += edge * lift[axis]
            square += edge * edge
        # Written so that NaN is a tilt.
        tilt = tilt if abs(along) <= tilt else abs(along)
        if square > longest:
            longest, longest_corner = square, corner
    if tilt <= _MOST_TILT:
        return
    begin, end = faces[prim, longest_corner], faces[prim, (longest_corner + 1) % 3]
    edge = (vertices[end] - vertices[begin]) * scale
    edge /= np.sqrt(longest)
    # The axis that is most across the edge, less its share along it.
    across = np.argmin(np.abs(edge))
    lift[:] = -edge[across] * edge
    lift[across] += 1.0
    lift /= np.sqrt(lift[0] ** 2 + lift[1] ** 2 + lift[2] ** 2)


@compiled
def _find_lifts(triangles, prim_ids, lifts):
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            lifts[hit] = np.nan
        else:
            _find_lift(triangles, prim_ids[hit], lifts[hit])


@compiled(error_model="numpy")
def _offset(triangles, local_vertices, centre, prim_ids, locations, is_front, points):
    faces, scale = triangles.faces, triangles.scale
    lift, local = np.empty(3), np.empty(3)
    for hit in range(len(prim_ids)):
        prim = prim_ids[hit]
        if prim == NO_PRIM:
            points[hit] = np.nan
            continue
        _find_lift(triangles, prim, lift)
        if not is_front[hit]:
            lift[:] = -lift
        # The point in the tracer's coordinates, and how far rounding can move it and the surface along the vector.
        reach, breadth, coarseness = 0.0, 0.0, 0.0
        for axis in range(3):
            local[axis] = (locations[hit, axis] - centre[axis]) * scale
            reach = max(reach, abs(local[axis]))
            breadth += abs(lift[axis])
            coarseness += abs(lift[axis]) * abs(locations[hit, axis]) * scale
        # The highest corner of the tracer's triangle above the point.
        highest = 0.0
        for corner in range(3):
            vertex, height = faces[prim, corner], 0.0
            for axis in range(3):
                height += (local_vertices[vertex, axis] - local[axis]) * lift[axis]
            highest = max(highest, height)
        distance = highest + _ROUNDINGS * _ROUNDING * (reach + 1.0) * breadth + 2 * _DOUBLE_ROUNDING * coarseness
        for axis in range(3):
            points[hit, axis] = locations[hit, axis] + distance * lift[axis] / scale

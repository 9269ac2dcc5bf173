"""Chooses the face that faces a point most directly, among the faces that are equally near to it.

For most points outside a mesh, the closest point is on an edge or a vertex, which belongs to several faces. The device
returns the face with the smallest number. trimesh returns the face whose normal points to the point most directly, and
this module chooses the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...geometry.appearance.normals import VertexFaces
from ...structs import NO_PRIM
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import triangles_of
from .refine import ClosestPoints, closest_on_triangle

# Squared distances are equal when they differ by less than this share: a thousand roundings of float64.
_ROUNDING = 2.0**-42

# Largest tolerance of squared distances, as a share of them: next to the surface, the tolerance that trimesh adds to
# squares would return points that are not the closest.
_LARGEST_SHARE = 2.0**-20

# Cosines are equal when they differ by less than this: those of coplanar faces differ by roundings.
_SAME_COSINE = 2.0**-42

# A point farther away than this many sizes of the mesh keeps its face: the faces there differ by less than rounding.
_FAR_SHARE = 2.0**20


def choose_facing(
    points: NDArray[np.float64], mesh: Mesh, around: VertexFaces, tolerance: float, closest: ClosestPoints
) -> None:
    """Replace each face by the one that faces the point most directly, among equally near ones around it.

    Parameters
    ----------
    points : (n, 3) float64, contiguous, the file's coordinates
    mesh : Mesh
    around : VertexFaces
        Of the mesh.
    tolerance : float, the file's unit squared
        Squared distances that differ by less are equal; points as near as this to the surface keep their faces.
    closest : ClosestPoints of the points, contiguous, written
        With the point and the distance of the face that is chosen.

    Notes
    -----
    Candidates are the faces that share a vertex with the face that was found. A nearer one replaces it, too, because
    the device chooses in float32. Of equally direct ones, the smallest number wins.
    """

    def choose(begin: int, end: int) -> None:
        distance, point, prim_id = closest
        part = ClosestPoints(distance[begin:end], point[begin:end], prim_id[begin:end])
        _choose(points[begin:end], triangles_of(mesh), mesh.origin, around, tolerance, part)

    with HostThreads() as threads:
        threads.for_ranges(len(points), choose)


@compiled(error_model="numpy")
def _choose(points, triangles, centre, around, tolerance, closest):
    scale = triangles.scale
    a, b, c, weights, nearest = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    best_weights = np.empty(3)
    for index in range(len(points)):
        own, point = closest.prim_id[index], points[index]
        is_far = False
        for axis in range(3):
            is_far |= not abs((point[axis] - centre[axis]) * scale) < _FAR_SHARE
        if own == NO_PRIM or is_far:
            continue
        least = _see(point, triangles, own, a, b, c, weights)
        if least <= tolerance * scale * scale:
            continue
        equal = max(min(tolerance * scale * scale, least * _LARGEST_SHARE), least * _ROUNDING)
        best, facing = own, _facing(a, b, c, weights, least)
        best_weights[0], best_weights[1], best_weights[2] = weights[0], weights[1], weights[2]
        for corner in range(3):
            point_id = around.point_ids[triangles.faces[own, corner]]
            for slot in range(around.begin[point_id], around.begin[point_id + 1]):
                face = around.faces[slot]
                if face == own:
                    continue
                squared = _see(point, triangles, face, a, b, c, weights)
                if not squared < least + equal:
                    continue
                other = _facing(a, b, c, weights, squared)
                is_nearer = squared <= least - equal
                is_equal = abs(other - facing) <= _SAME_COSINE and face < best
                if is_nearer or is_equal or other > facing + _SAME_COSINE:
                    best, facing, least = face, other, min(least, squared)
                    best_weights[0], best_weights[1], best_weights[2] = weights[0], weights[1], weights[2]
        if best == own:
            continue
        closest.prim_id[index] = best
        first, second, third = triangles.faces[best, 0], triangles.faces[best, 1], triangles.faces[best, 2]
        away = 0.0
        for axis in range(3):
            origin = triangles.vertices[first, axis]
            to_second, to_third = triangles.vertices[second, axis] - origin, triangles.vertices[third, axis] - origin
            nearest[axis] = origin + (best_weights[1] * to_second + best_weights[2] * to_third)
            away += ((nearest[axis] - point[axis]) * scale) ** 2
            closest.point[index, axis] = nearest[axis]
        closest.distance[index] = np.sqrt(away) / scale


@compiled(error_model="numpy")
def _see(point, triangles, face, a, b, c, weights):
    """Write the corners as seen from a point, and the closest point's weights; return its squared distance, scaled."""
    for axis in range(3):
        a[axis] = (triangles.vertices[triangles.faces[face, 0], axis] - point[axis]) * triangles.scale
        b[axis] = (triangles.vertices[triangles.faces[face, 1], axis] - point[axis]) * triangles.scale
        c[axis] = (triangles.vertices[triangles.faces[face, 2], axis] - point[axis]) * triangles.scale
    return closest_on_triangle(a, b, c, weights)


@compiled(error_model="numpy")
def _facing(a, b, c, weights, squared):
    """Return the cosine between the normal and the way to the point; -2 for a triangle without a normal."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return -2.0
    along = 0.0
    for axis, component in enumerate((nx, ny, nz)):
        along -= component * (weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis])
    return along / (length * np.sqrt(squared))

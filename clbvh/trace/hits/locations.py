"""Locations and normals of hits in float64, by face and barycentric coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import NO_PRIM
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import triangles_of

# A normal is not used if the corners of its triangle differ by more than this in height, in local units: sixteen
# roundings of float32.
_MOST_TILT = 2.0**-20


def find_locations(
    mesh: Mesh,
    prim_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64, the file's coordinates: ``(1 - u - v) a + u b + v c``; NaN without a face."""
    locations = np.empty((*prim_id.shape, 3))
    flat = locations.reshape(-1, 3)
    prims = np.ascontiguousarray(prim_id).reshape(-1)
    us, vs = (np.ascontiguousarray(values, np.float64).reshape(-1) for values in (u, v))

    def locate(begin: int, end: int) -> None:
        _locate(triangles_of(mesh), prims[begin:end], us[begin:end], vs[begin:end], flat[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(flat), locate)
    return locations


def find_normals(mesh: Mesh, prim_id: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals on the side from which the corners run anticlockwise.

    Across its longest edge for a triangle so thin that float64 does not know its normal. NaN without a face, and for a
    triangle whose corners are one point.
    """
    normals = np.empty((*prim_id.shape, 3))
    _make_normals(triangles_of(mesh), np.ascontiguousarray(prim_id).reshape(-1), normals.reshape(-1, 3))
    return normals


@compiled
def _locate(triangles, prim_ids, us, vs, locations):
    vertices, faces = triangles.vertices, triangles.faces
    for hit in range(len(prim_ids)):
        prim, u, v = prim_ids[hit], us[hit], vs[hit]
        for axis in range(3):
            if prim == NO_PRIM:
                locations[hit, axis] = np.nan
                continue
            a = vertices[faces[prim, 0], axis]
            ab, ac = vertices[faces[prim, 1], axis] - a, vertices[faces[prim, 2], axis] - a
            locations[hit, axis] = a + (u * ab + v * ac)


@compiled
def _make_normals(triangles, prim_ids, normals):
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
        else:
            make_normal(triangles, prim_ids[hit], normals[hit])


@compiled(error_model="numpy")
def make_normal(triangles, prim, normal):
    """Write the unit normal of a triangle on the side from which its corners run anticlockwise.

    A triangle so thin that float64 does not know its normal gets a vector across its longest edge.
    """
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    a, b, c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
    # Divided by its largest component first: the squares of a small triangle's normal could underflow.
    largest = 0.0
    for axis in range(3):
        following, last = (axis + 1) % 3, (axis + 2) % 3
        ab_following, ab_last = vertices[b, following] - vertices[a, following], vertices[b, last] - vertices[a, last]
        ac_following, ac_last = vertices[c, following] - vertices[a, following], vertices[c, last] - vertices[a, last]
        normal[axis] = ab_following * scale * (ac_last * scale) - ab_last * scale * (ac_following * scale)
        largest = max(largest, abs(normal[axis]))
    for axis in range(3):
        normal[axis] /= largest
    _normalize(normal)
    # Written so that NaN is a tilt.
    if not _tilt(triangles, prim, normal) <= _MOST_TILT:
        _write_across(triangles, prim, normal)


@compiled(error_model="numpy")
def _normalize(vector):
    length = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for axis in range(3):
        vector[axis] /= length


@compiled
def _tilt(triangles, prim, normal):
    """Return how much higher one corner of a triangle is than another one along a vector, in local units."""
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    to_b, to_c = 0.0, 0.0
    for axis in range(3):
        a = vertices[faces[prim, 0], axis]
        to_b += (vertices[faces[prim, 1], axis] - a) * scale * normal[axis]
        to_c += (vertices[faces[prim, 2], axis] - a) * scale * normal[axis]
    return abs(to_b) + abs(to_c)


@compiled(error_model="numpy")
def _write_across(triangles, prim, normal):
    """Write a unit vector at right angles to the longest edge of a triangle; NaN if all edges have length zero."""
    vertices, faces = triangles.vertices, triangles.faces
    longest, edge = 0.0, np.zeros(3)
    for corner in range(3):
        begin, end = faces[prim, corner], faces[prim, (corner + 1) % 3]
        length = 0.0
        for axis in range(3):
            length = max(length, abs(vertices[end, axis] - vertices[begin, axis]))
        if length > longest:
            longest = length
            for axis in range(3):
                edge[axis] = vertices[end, axis] - vertices[begin, axis]
    # Divided by its largest component first, as the normal is.
    for axis in range(3):
        edge[axis] /= longest
    _normalize(edge)
    # The axis that is most across the edge, less its share along it.
    across = 0
    for axis in range(1, 3):
        across = axis if abs(edge[axis]) < abs(edge[across]) else across
    share = edge[across]
    for axis in range(3):
        normal[axis] = (1.0 if axis == across else 0.0) - share * edge[axis]
    _normalize(normal)

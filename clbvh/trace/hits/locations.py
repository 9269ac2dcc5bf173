"""Locations and normals of hits in float64, by face and barycentric coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import NO_PRIM
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import triangles_of


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

    NaN without a face, and for a triangle without area.
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
            normals[hit] = np.nan
        else:
            make_normal(triangles, prim_ids[hit], normals[hit])


@compiled(error_model="numpy")
def make_normal(triangles, prim, normal):
    """Write the unit normal of a triangle on the side from which its corners run anticlockwise; NaN without area."""
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
    normal /= np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)

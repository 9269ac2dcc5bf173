"""Points of a mesh's surface in float64, by face and barycentric coordinates."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..host_threads import HostThreads
from ..layout import NO_PRIM


def find_locations(
    mesh: Mesh,
    prim_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64, the file's coordinates: ``(1 - u - v) a + u b + v c``; NaN without a face."""
    places = np.empty((*prim_id.shape, 3))
    rows = places.reshape(-1, 3)
    prims = np.ascontiguousarray(prim_id).reshape(-1)
    us, vs = (np.ascontiguousarray(values, np.float64).reshape(-1) for values in (u, v))
    with HostThreads() as threads:
        threads.for_ranges(
            len(rows),
            lambda first, last: _locate(
                mesh.vertices, mesh.faces, mesh.origin, prims[first:last], us[first:last], vs[first:last],
                rows[first:last],
            ),
        )  # fmt: skip
    return places


def find_normals(mesh: Mesh, prim_id: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals on the side from which the corners run anticlockwise; NaN without a face.

    NaN for a triangle without area, too.
    """
    normals = np.empty((*prim_id.shape, 3))
    _make_normals(
        mesh.vertices, mesh.faces, np.ascontiguousarray(prim_id).reshape(-1), normals.reshape(-1, 3),
    )  # fmt: skip
    return normals


@njit(cache=True, nogil=True)
def _locate(vertices, faces, origin, prim_ids, us, vs, places):  # type: ignore[no-untyped-def]
    for row in range(len(prim_ids)):
        prim, u, v = prim_ids[row], us[row], vs[row]
        for axis in range(3):
            if prim == NO_PRIM:
                places[row, axis] = np.nan
                continue
            a = np.float64(vertices[faces[prim, 0], axis])
            ab, ac = vertices[faces[prim, 1], axis] - a, vertices[faces[prim, 2], axis] - a
            places[row, axis] = origin[axis] + (a + (u * ab + v * ac))


@njit(cache=True, nogil=True, error_model="numpy")
def _make_normals(vertices, faces, prim_ids, normals):  # type: ignore[no-untyped-def]
    ab, ac = np.empty(3), np.empty(3)
    for row in range(len(prim_ids)):
        prim = prim_ids[row]
        if prim == NO_PRIM:
            normals[row] = np.nan
            continue
        for axis in range(3):
            a = np.float64(vertices[faces[prim, 0], axis])
            ab[axis], ac[axis] = vertices[faces[prim, 1], axis] - a, vertices[faces[prim, 2], axis] - a
        # Float64 holds the product of two float32 numbers of any size, but not its square.
        largest = 0.0
        for axis in range(3):
            following, last = (axis + 1) % 3, (axis + 2) % 3
            normals[row, axis] = ab[following] * ac[last] - ab[last] * ac[following]
            largest = max(largest, abs(normals[row, axis]))
        for axis in range(3):
            normals[row, axis] /= largest
        normals[row] /= np.sqrt(normals[row, 0] ** 2 + normals[row, 1] ** 2 + normals[row, 2] ** 2)

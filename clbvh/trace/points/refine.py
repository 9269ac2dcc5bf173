"""Points on their way to the device, and the nearest points of the surface, in float64, on their way back."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import NO_PRIM
from .rays import RayBox

POINT = np.dtype([("position", np.float32, 3)])

# A point further away than this many times half the box's size is moved to there, towards the middle. From there on,
# which triangle is nearest depends on little but the direction: by half of half the size over this number. Further
# out float32 would cost more: sixteen roundings of this are as much.
_FAR_SHARE = 512.0

# The same in float64, where the place on the triangle is found.
_REFINED_FAR_SHARE = 2.0**20


class ClosestPoints(NamedTuple):
    """The nearest points of a surface.

    Attributes
    ----------
    distance : (n,) float64, object units
    point : (n, 3) float64, the file's coordinates
    prim_id : (n,) int32
        The face that the point is on.
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]


def unit_scale(box: RayBox) -> np.float32:
    """Return a power of two that makes a box about as large as 1."""
    return np.float32(math.ldexp(1.0, -math.frexp(float(box.half.max()))[1])) if box.half.any() else np.float32(1.0)


def check_points(points: NDArray[Any], first_row: int) -> None:
    """Raise `ValueError` with the number of the first point that is not finite, counting from `first_row`."""
    is_good = np.isfinite(points).all(axis=1)
    if not is_good.all():
        bad = int(np.argmin(is_good))
        raise ValueError(f"points[{first_row + bad}] is not finite: {points[bad]}")


def pack_points(points: NDArray[Any], box: RayBox, order: NDArray[np.int32], rows: NDArray[np.void]) -> None:
    """Write points as the device wants them.

    Parameters
    ----------
    points : (n, 3) float, contiguous
        Finite.
    box : RayBox
    order : (m,) int32
        Which of them are written, one after the other.
    rows : (m,) `POINT`
        Written.
    """
    _pack(points, order, box.centre, _FAR_SHARE * box.half.max(), rows.view(np.float32).reshape(-1, 3))


@njit(cache=True, nogil=True)
def _pack(points, order, centre, far, rows):  # type: ignore[no-untyped-def]
    for place in range(len(order)):
        point = order[place]
        size = 0.0
        for axis in range(3):
            size = max(size, abs(points[point, axis] - centre[axis]))
        nearer = far / size if size > far else 1.0
        for axis in range(3):
            rows[place, axis] = (points[point, axis] - centre[axis]) * nearer


def refine_points(
    points: NDArray[Any],
    mesh: Mesh,
    box: RayBox,
    order: NDArray[np.int32],
    prim_id: NDArray[np.int32],
    found: ClosestPoints,
) -> None:
    """Write the point of each face that is nearest to a point, in float64.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the file's coordinates
    mesh : Mesh
    box : RayBox
    order : (m,) int32
        Which of the points were looked at, one after the other.
    prim_id : (m,) int32
        What the device found.
    found : ClosestPoints
        As many as there are points; those that were looked at are written. Without a face the distance is infinite and
        the point NaN.
    """
    far = _REFINED_FAR_SHARE * box.half.max()
    _refine(points, order, mesh.origin, far, mesh.vertices, mesh.faces, prim_id, *found)


@njit(cache=True, nogil=True, error_model="numpy")
def _refine(points, order, origin, far, vertices, faces, found, distance, nearest, prim_id):  # type: ignore[no-untyped-def]
    # Relative to the point, which is zero then.
    a, b, c, weights, away = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for place in range(len(order)):
        row, prim = order[place], found[place]
        prim_id[row] = prim
        if prim == NO_PRIM:
            distance[row] = np.inf
            nearest[row] = np.nan
            continue
        size = 0.0
        for axis in range(3):
            size = max(size, abs(points[row, axis] - origin[axis]))
        nearer = far / size if size > far else 1.0
        first, second, third = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        for axis in range(3):
            local = (points[row, axis] - origin[axis]) * nearer
            a[axis] = vertices[first, axis] - local
            b[axis] = vertices[second, axis] - local
            c[axis] = vertices[third, axis] - local
        squared = _nearest_of_edge(a, b, 0, 1, weights, np.inf)
        squared = _nearest_of_edge(b, c, 1, 2, weights, squared)
        squared = _nearest_of_edge(c, a, 2, 0, weights, squared)
        squared = _nearest_of_middle(a, b, c, weights, squared)
        for axis in range(3):
            corner = np.float64(vertices[first, axis])
            to_second, to_third = vertices[second, axis] - corner, vertices[third, axis] - corner
            local = corner + weights[1] * to_second + weights[2] * to_third
            nearest[row, axis] = origin[axis] + local
            away[axis] = (local - (points[row, axis] - origin[axis])) / size if nearer < 1.0 else 0.0
        distance[row] = np.sqrt(squared) if nearer == 1.0 else size * np.sqrt((away * away).sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_of_edge(begin, end, begin_corner, end_corner, weights, squared):  # type: ignore[no-untyped-def]
    """Write the weights of the edge's nearest point if it is nearer than before; return its squared distance."""
    dx, dy, dz = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    share = -(begin[0] * dx + begin[1] * dy + begin[2] * dz) / (dx * dx + dy * dy + dz * dz)
    share = min(share, 1.0) if share > 0.0 else 0.0
    x, y, z = begin[0] + share * dx, begin[1] + share * dy, begin[2] + share * dz
    if x * x + y * y + z * z >= squared:
        return squared
    weights[:] = 0.0
    weights[begin_corner], weights[end_corner] = 1.0 - share, share
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_of_middle(a, b, c, weights, squared):  # type: ignore[no-untyped-def]
    """Write the weights of the foot of the perpendicular if it is in the triangle; return its squared distance."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    weight_a = nx * (b[1] * c[2] - b[2] * c[1]) + ny * (b[2] * c[0] - b[0] * c[2]) + nz * (b[0] * c[1] - b[1] * c[0])
    weight_b = nx * (c[1] * a[2] - c[2] * a[1]) + ny * (c[2] * a[0] - c[0] * a[2]) + nz * (c[0] * a[1] - c[1] * a[0])
    weight_c = nx * (a[1] * b[2] - a[2] * b[1]) + ny * (a[2] * b[0] - a[0] * b[2]) + nz * (a[0] * b[1] - a[1] * b[0])
    total = weight_a + weight_b + weight_c
    if not (weight_a >= 0.0 and weight_b >= 0.0 and weight_c >= 0.0 and total > 0.0):
        return squared
    # The plane's distance along its normal: better than the weighted sum of corners, which cancel.
    along = a[0] * nx + a[1] * ny + a[2] * nz
    of_plane = along * along / (nx * nx + ny * ny + nz * nz)
    if of_plane >= squared:
        return squared
    weights[0], weights[1], weights[2] = weight_a / total, weight_b / total, weight_c / total
    return of_plane

"""The closest points of the primitives that the device found in a scene, in float64 from the placed geometry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.powers_of_two import exponent_of, times_power_of_two
from ..hits.scene_arrays import SceneArrays, place_point, place_vector
from .ellipsoid import find_axes, find_shares
from .refine import closest_on_triangle

# A point farther away than this many sizes of the primitive is moved to that distance, towards the primitive. Beyond
# it, float64 would round the way to the primitive by more than the closest point changes: by a size over this number.
_FAR_SHARE = 2.0**26

_SPHERES = PRIM_KINDS["spheres"]


class FoundPoints(NamedTuple):
    """The results for points in a scene, (n,) each.

    Attributes
    ----------
    distance : (n,) float64, the scene's unit
    point : (n, 3) float64, the scene's coordinates
    prim_id, instance_id : (n,) int32
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, count: int) -> FoundPoints:
        """Return arrays for a number of points, which are not filled."""
        return cls(np.empty(count), np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32))

    def part(self, begin: int, end: int) -> FoundPoints:
        """Return views of the results of points `begin` to `end`."""
        distance, point, prim_id, instance_id = self
        return FoundPoints(distance[begin:end], point[begin:end], prim_id[begin:end], instance_id[begin:end])


def refine_scene_points(
    points: NDArray[Any],
    arrays: SceneArrays,
    order: NDArray[np.int32],
    prims: NDArray[np.void],
    found: FoundPoints,
) -> None:
    """Write the point of each primitive that is closest to a point, in float64.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the scene's coordinates
    arrays : SceneArrays
    order : (m,) int32
        Indices of the points that were cast, one after the other.
    prims : (m,) `structs.SCENE_PRIM`
        Primitives that the device found, in that order.
    found : FoundPoints of n points, written
        Only for the points in `order`. Without a primitive the distance is infinite, the point NaN, and the ids
        `NO_PRIM`.
    """
    _refine(points, order, arrays, prims["prim_id"], prims["instance_id"], found)


class _Scratch(NamedTuple):
    """Memory for one point after the other: four vectors, two matrices by rows, and the closest point."""

    rows: NDArray[np.float64]
    way: NDArray[np.float64]
    matrix: NDArray[np.float64]
    axes: NDArray[np.float64]
    nearest: NDArray[np.float64]


@compiled(error_model="numpy")
def _refine(points, order, arrays, prim_ids, instance_ids, found):
    scratch = _Scratch(np.empty((4, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty(3))
    for slot in range(len(order)):
        index, prim, instance = order[slot], prim_ids[slot], instance_ids[slot]
        found.prim_id[index], found.instance_id[index] = prim, instance
        if prim == NO_PRIM:
            found.distance[index] = np.inf
            found.point[index, 0] = found.point[index, 1] = found.point[index, 2] = np.nan
            continue
        if arrays.kind[arrays.geometry_id[instance]] == _SPHERES:
            found.distance[index] = _close_to_sphere(points[index], arrays, instance, prim, scratch)
        else:
            found.distance[index] = _close_to_triangle(points[index], arrays, instance, prim, scratch)
        for axis in range(3):
            found.point[index, axis] = scratch.nearest[axis]


@compiled(error_model="numpy")
def _close_to_triangle(point, arrays, instance, prim, scratch):
    """Write the closest point of a placed triangle, and return its distance.

    The edges are placed by themselves: far from zero they keep digits that differences of placed corners would lose.
    """
    geometry, way, nearest = arrays.geometry_id[instance], scratch.way, scratch.nearest
    face, row = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
    first, second, third = row + arrays.faces[face, 0], row + arrays.faces[face, 1], row + arrays.faces[face, 2]
    vertices = arrays.vertices
    x, y, z = vertices[first, 0], vertices[first, 1], vertices[first, 2]
    ux, uy, uz = vertices[second, 0] - x, vertices[second, 1] - y, vertices[second, 2] - z
    vx, vy, vz = vertices[third, 0] - x, vertices[third, 1] - y, vertices[third, 2] - z
    a, b, c, weights = scratch.rows[0], scratch.rows[1], scratch.rows[2], scratch.rows[3]
    b[0], b[1], b[2] = place_vector(arrays, instance, ux, uy, uz)
    c[0], c[1], c[2] = place_vector(arrays, instance, vx, vy, vz)
    way[0], way[1], way[2] = place_point(arrays, instance, x, y, z)
    size, reach = 0.0, 0.0
    for axis in range(3):
        way[axis] -= point[axis]
        size = max(size, abs(b[axis]), abs(c[axis]))
        reach = max(reach, abs(way[axis]))
    is_far = reach > _FAR_SHARE * size
    share = _FAR_SHARE * size / reach if is_far else 1.0
    exponent = exponent_of(max(reach * share, size))
    for axis in range(3):
        a[axis] = times_power_of_two(way[axis] * share, -exponent)
        b[axis] = a[axis] + times_power_of_two(b[axis], -exponent)
        c[axis] = a[axis] + times_power_of_two(c[axis], -exponent)
    squared = closest_on_triangle(a, b, c, weights)
    nearest[0], nearest[1], nearest[2] = place_point(
        arrays, instance, x + (weights[1] * ux + weights[2] * vx), y + (weights[1] * uy + weights[2] * vy),
        z + (weights[1] * uz + weights[2] * vz),
    )  # fmt: skip
    if is_far:
        return _distance_between(point, nearest)
    return times_power_of_two(np.sqrt(squared), exponent)


@compiled(error_model="numpy")
def _close_to_sphere(point, arrays, instance, prim, scratch):
    """Write the closest point of the ellipsoid that a placed sphere is, and return its distance."""
    sphere = arrays.first_sphere[arrays.geometry_id[instance]] + prim
    spheres, radius = arrays.spheres, arrays.spheres[sphere, 3]
    way, matrix, axes, nearest = scratch.way, scratch.matrix, scratch.axes, scratch.nearest
    way[0], way[1], way[2] = place_point(arrays, instance, spheres[sphere, 0], spheres[sphere, 1], spheres[sphere, 2])
    largest = 0.0
    for row in range(3):
        for column in range(3):
            largest = max(largest, abs(arrays.linear[instance, row, column]))
    # Squares of the scaled entries, and of what is scaled by the radius as well, are in float64.
    stretch = exponent_of(largest)
    for row in range(3):
        for column in range(3):
            matrix[row, column] = times_power_of_two(arrays.linear[instance, row, column], -stretch)
    find_axes(matrix, axes)
    unit, size = exponent_of(radius) + stretch, times_power_of_two(radius, stretch)
    radius = times_power_of_two(radius, -exponent_of(radius))
    position, lengths, shares = scratch.rows[0], scratch.rows[1], scratch.rows[2]
    reach = 0.0
    for axis in range(3):
        nearest[axis] = way[axis]
        way[axis] = point[axis] - way[axis]
        reach = max(reach, abs(way[axis]))
    is_far = reach > _FAR_SHARE * size
    share = _FAR_SHARE * size / reach if is_far else 1.0
    for axis in range(3):
        way[axis] = times_power_of_two(way[axis] * share, -unit)
    for row in range(3):
        squared, along = 0.0, 0.0
        for axis in range(3):
            squared += axes[row, axis] * axes[row, axis]
            along += axes[row, axis] * way[axis]
        length = np.sqrt(squared)
        lengths[row] = length * radius
        position[row] = along / length
    signs = scratch.rows[3]
    for row in range(3):
        signs[row] = -1.0 if position[row] < 0.0 else 1.0
        position[row] = abs(position[row])
    find_shares(position, lengths, shares)
    squared = 0.0
    for row in range(3):
        away = position[row] - shares[row] * lengths[row]
        squared += away * away
        for axis in range(3):
            nearest[axis] += times_power_of_two(signs[row] * shares[row] * radius * axes[row, axis], unit)
    if is_far:
        return _distance_between(point, nearest)
    return times_power_of_two(np.sqrt(squared), unit)


@compiled(error_model="numpy")
def _distance_between(point, nearest):
    """Return the distance of a point from its closest one, whose square may leave float64."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, abs(nearest[axis] - point[axis]))
    exponent = exponent_of(largest)
    squared = 0.0
    for axis in range(3):
        away = times_power_of_two(nearest[axis] - point[axis], -exponent)
        squared += away * away
    return times_power_of_two(np.sqrt(squared), exponent)

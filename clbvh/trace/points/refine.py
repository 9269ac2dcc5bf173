"""The closest points of the primitives that the device found, in float64: on a mesh, or on placed geometries."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.loop_functions import exponent_of, times_power_of_two
from ..rays.batch import TreeBox
from ..world.surface_arrays import SurfaceArrays, place_point, place_vector
from .ellipsoid import find_axes, find_shares

# A point further away than this many times half the box's size is moved to that distance, towards the centre: beyond
# it, float64 would round the differences to the corners more than the move changes.
_FAR_SHARE = 2.0**20


class ClosestPoints(NamedTuple):
    """The closest points of a surface.

    Attributes
    ----------
    distance : (...,) float64, the file's unit
    point : (..., 3) float64, the file's coordinates
    prim_id : (...,) int32
        The face that the point is on.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh) as tracer:
    ...     distance, point, prim_id = tracer.closest_point([[1, 1, 3], [-3, -4, 0]])
    >>> distance, point
    (array([3., 5.]), array([[1., 1., 0.],
           [0., 0., 0.]]))
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]

    @property
    def geometry_id(self) -> NDArray[np.int32]:
        """(...,) int32: the geometry that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0)

    @property
    def instance_id(self) -> NDArray[np.int32]:
        """(...,) int32: the instance that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0)

    def __repr__(self) -> str:
        return f"ClosestPoints(shape={self.prim_id.shape}, found={np.count_nonzero(self.prim_id != NO_PRIM):,})"


class SceneClosestPoints(ClosestPoints):
    """The closest points in a scene: `ClosestPoints` that know the instance.

    As a tuple they are distance, point and prim_id, like those of a mesh.

    Attributes
    ----------
    geometry_id, instance_id : (...,) int32
        The geometry and the instance that the point is on; -1 where there is no point.
    """

    _ids: tuple[NDArray[np.int32], NDArray[np.int32]]

    def __new__(
        cls,
        distance: NDArray[np.float64],
        point: NDArray[np.float64],
        prim_id: NDArray[np.int32],
        geometry_id: NDArray[np.int32],
        instance_id: NDArray[np.int32],
    ) -> SceneClosestPoints:
        """Return the closest points with their ids."""
        closest = super().__new__(cls, distance, point, prim_id)
        closest._ids = geometry_id, instance_id
        return closest

    @property
    def geometry_id(self) -> NDArray[np.int32]:  # noqa: D102
        return self._ids[0]

    @property
    def instance_id(self) -> NDArray[np.int32]:  # noqa: D102
        return self._ids[1]

    def __getnewargs__(self) -> tuple[Any, ...]:  # for copies and pickles
        return (*self, *self._ids)


@compiled(error_model="numpy")
def _refine_lone(points, order, arrays, box, far, prim_ids, found):
    vertices, faces = arrays.vertices, arrays.faces
    centre, scale = box.centre, box.scale
    distance, nearest = found.distance, found.point
    # The corners in local units, as seen from the point.
    a, b, c, weights, away = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for slot in range(len(order)):
        index, prim = order[slot], prim_ids[slot]
        found.prim_id[index], found.instance_id[index] = prim, min(prim, 0)
        if prim == NO_PRIM:
            distance[index] = np.inf
            nearest[index, 0] = nearest[index, 1] = nearest[index, 2] = np.nan
            continue
        size = 0.0
        for axis in range(3):
            size = max(size, abs((points[index, axis] - centre[axis]) * scale))
        first, second, third = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        is_far = size > far
        for axis in range(3):
            x, share = np.float64(points[index, axis]), far / size
            point = centre[axis] + (x - centre[axis]) * share if is_far else x
            a[axis] = (vertices[first, axis] - point) * scale
            b[axis] = (vertices[second, axis] - point) * scale
            c[axis] = (vertices[third, axis] - point) * scale
        squared = closest_on_triangle(a, b, c, weights)
        for axis in range(3):
            corner = vertices[first, axis]
            to_second, to_third = vertices[second, axis] - corner, vertices[third, axis] - corner
            nearest[index, axis] = corner + (weights[1] * to_second + weights[2] * to_third)
            # In sizes, so that the square of a huge distance is in float64.
            away[axis] = (nearest[index, axis] - points[index, axis]) * scale / size if is_far else 0.0
        # Not numpy's `sum`, which takes long to compile.
        squared_away = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
        local = size * np.sqrt(squared_away) if is_far else np.sqrt(squared)
        distance[index] = local / scale


@compiled(error_model="numpy")
def closest_on_triangle(a, b, c, weights):
    """Write the weights of the corners at the point closest to zero; return its squared distance from there."""
    squared = _closest_on_edge(a, b, 0, 1, weights, np.inf)
    squared = _closest_on_edge(b, c, 1, 2, weights, squared)
    squared = _closest_on_edge(c, a, 2, 0, weights, squared)
    return _closest_inside(a, b, c, weights, squared)


@compiled(error_model="numpy")
def _closest_on_edge(begin, end, begin_corner, end_corner, weights, squared):
    """Write the weights of the edge's closest point if it is closer than before; return its squared distance."""
    dx, dy, dz = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    share = -(begin[0] * dx + begin[1] * dy + begin[2] * dz) / (dx * dx + dy * dy + dz * dz)
    share = min(share, 1.0) if share > 0.0 else 0.0
    x, y, z = begin[0] + share * dx, begin[1] + share * dy, begin[2] + share * dz
    if x * x + y * y + z * z >= squared:
        return squared
    weights[0] = weights[1] = weights[2] = 0.0
    weights[begin_corner], weights[end_corner] = 1.0 - share, share
    return x * x + y * y + z * z


@compiled(error_model="numpy")
def _closest_inside(a, b, c, weights, squared):
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


# A point farther away than this many sizes of the primitive is moved to that distance, towards the primitive. Beyond
# it, float64 would round the way to the primitive by more than the closest point changes: by a size over this number.
_FAR_PRIM_SHARE = 2.0**26

_SPHERES = PRIM_KINDS["spheres"]


class FoundPoints(NamedTuple):
    """The results for points, (n,) each.

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


def refine_points(
    points: NDArray[Any],
    arrays: SurfaceArrays,
    box: TreeBox,
    order: NDArray[np.int32],
    prims: NDArray[Any],
    found: FoundPoints,
) -> None:
    """Write the point of each primitive that is closest to a point, in float64.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the scene's coordinates
    arrays : SurfaceArrays
    box : TreeBox
        Of the tree.
    order : (m,) int32
        Indices of the points that were cast, one after the other.
    prims : (m,) `structs.WORLD_PRIM`, or int32 of a lone mesh
        Primitives that the device found, in that order.
    found : FoundPoints of n points, written
        Only for the points in `order`. Without a primitive the distance is infinite, the point NaN, and the ids
        `NO_PRIM`.
    """
    if arrays.is_lone:
        _refine_lone(points, order, arrays, box, _FAR_SHARE * box.half.max(), prims, found)
    else:
        _refine_placed(points, order, arrays, prims["prim_id"], prims["instance_id"], found)


class _Scratch(NamedTuple):
    """Memory for one point after the other: four vectors, two matrices by rows, and the closest point."""

    rows: NDArray[np.float64]
    way: NDArray[np.float64]
    matrix: NDArray[np.float64]
    axes: NDArray[np.float64]
    nearest: NDArray[np.float64]


@compiled(error_model="numpy")
def _refine_placed(points, order, arrays, prim_ids, instance_ids, found):
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
    is_far = reach > _FAR_PRIM_SHARE * size
    share = _FAR_PRIM_SHARE * size / reach if is_far else 1.0
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
    is_far = reach > _FAR_PRIM_SHARE * size
    share = _FAR_PRIM_SHARE * size / reach if is_far else 1.0
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

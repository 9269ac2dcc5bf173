"""The closest points of the primitives that the device found, in float64."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import HIT, NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.loop_functions import exponent_of, power_of_two, times_power_of_two
from ..hits.hits import show_found, show_index, show_values
from ..world.metrics import Metrics
from ..world.surface_arrays import SurfaceArrays, place_point, place_vector
from ..world.tree_box import TreeBox
from .ellipsoid import find_shares


class _Points(NamedTuple):
    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    prim_id: NDArray[np.int32]


class ClosestPoints(_Points):
    """The closest points of a surface; as a tuple distance, point and prim_id.

    Attributes
    ----------
    distance : (...,) float64, the file's unit
    point : (..., 3) float64, the file's coordinates
    prim_id : (...,) int32
        The face, or the sphere, that the point is on.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh) as tracer:
    ...     closest = tracer.closest_point([[1, 1, 3], [-3, -4, 0]])
    >>> closest
    ClosestPoints(shape=(2,), found=2, distance=3..5)
      [0] distance=3, prim_id=0, instance_id=0, point=(1, 1, 0)
      [1] distance=5, prim_id=0, instance_id=0, point=(0, 0, 0)
    >>> distance, point, prim_id = closest
    >>> distance, point
    (array([3., 5.]), array([[1., 1., 0.],
           [0., 0., 0.]]))
    """

    _ids: tuple[NDArray[np.int32], NDArray[np.int32]] | None = None

    def __new__(
        cls,
        distance: NDArray[np.float64],
        point: NDArray[np.float64],
        prim_id: NDArray[np.int32],
        geometry_id: NDArray[np.int32] | None = None,
        instance_id: NDArray[np.int32] | None = None,
    ) -> ClosestPoints:
        """Return the closest points with their ids, which are 0 where there is a point unless they are given."""
        closest = super().__new__(cls, distance, point, prim_id)
        if geometry_id is not None and instance_id is not None:
            closest._ids = geometry_id, instance_id
        return closest

    @property
    def geometry_id(self) -> NDArray[np.int32]:
        """(...,) int32: the geometry that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0) if self._ids is None else self._ids[0]

    @property
    def instance_id(self) -> NDArray[np.int32]:
        """(...,) int32: the instance that the point is on. Of a single mesh 0, and -1 where there is no point."""
        return np.minimum(self.prim_id, 0) if self._ids is None else self._ids[1]

    def __repr__(self) -> str:
        shape, is_found = self.prim_id.shape, self.prim_id != NO_PRIM
        if not shape:
            return f"ClosestPoints({self._show(()) if is_found else 'none'})"
        return show_found(
            f"ClosestPoints(shape={shape}, found={np.count_nonzero(is_found):,}", "distance", self.distance, is_found,
            lambda row: f"{show_index(row, shape)} {self._show(np.unravel_index(row, shape))}",
        )  # fmt: skip

    def _show(self, index: Any) -> str:
        instance = {} if self._ids is None else {"instance_id": self.instance_id[index]}
        return show_values(
            distance=self.distance[index], prim_id=self.prim_id[index], **instance, point=self.point[index]
        )


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


# A point farther from a lone mesh than this many times half the box's size is moved to that distance, towards the
# centre: beyond it, float64 would round the differences to the corners more than the move changes.
_FAR_SHARE = 2.0**20

# The same for an instance, in sizes of the primitive, and towards it: float64 would round the way to the primitive by
# more than the closest point changes, by a size over this number.
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

    def as_closest(self, shape: tuple[int, ...], geometry_ids: NDArray[np.int32]) -> ClosestPoints:
        """Return the results in a shape, given the geometry of each instance."""
        distance, point, prim_id, instance_id = self
        geometry_id = np.where(instance_id == NO_PRIM, NO_PRIM, geometry_ids[instance_id])
        return ClosestPoints(
            distance.reshape(shape), point.reshape(*shape, 3), prim_id.reshape(shape), geometry_id.reshape(shape),
            instance_id.reshape(shape),
        )  # fmt: skip


def refine_points(
    points: NDArray[Any],
    arrays: SurfaceArrays,
    metrics: Metrics,
    box: TreeBox,
    order: NDArray[np.int32],
    prims: NDArray[Any],
    found: FoundPoints,
    slots: NDArray[np.int32],
) -> None:
    """Write the point of each primitive that is closest to a point, in float64.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the world's coordinates
    arrays : SurfaceArrays
    metrics : Metrics
        Of the instances.
    box : TreeBox
        Of the world.
    order : (m,) int32
        The point of each primitive, by its index.
    prims : (m,) structs with a prim_id
        Primitives that the device found: hits, or with an instance_id of their own.
    found : FoundPoints, written
        Without a primitive the distance is infinite, the point NaN, and the ids `NO_PRIM`.
    slots : (m,) int32
        Where to write each of them.
    """
    # Contiguous, because numba would compile another version of the loop for others.
    prim_ids = prims["prim_id"].copy()
    instance_ids = np.minimum(prim_ids, 0) if prims.dtype == HIT else prims["instance_id"].copy()
    far = _FAR_SHARE * box.half.max() / box.scale
    _refine(
        points, order, arrays, metrics.axes, metrics.half_lengths, box.centre, far, prim_ids, instance_ids, slots,
        found,
    )  # fmt: skip


@compiled(error_model="numpy")
def _refine(points, order, arrays, axes, half_lengths, centre, far, prim_ids, instance_ids, slots, found):
    a, b, c, weights, way = scratch = (np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3))
    distance, nearest = found.distance, found.point
    vertices, faces, kind, geometry_id = arrays.vertices, arrays.faces, arrays.kind, arrays.geometry_id
    for row in range(len(order)):
        index, slot, prim, instance = order[row], slots[row], prim_ids[row], instance_ids[row]
        found.prim_id[slot], found.instance_id[slot] = prim, instance
        if prim == NO_PRIM:
            distance[slot] = np.inf
            nearest[slot, 0] = nearest[slot, 1] = nearest[slot, 2] = np.nan
            continue
        geometry = geometry_id[instance]
        if kind[geometry] == _SPHERES:
            distance[slot] = _close_to_sphere(
                points[index], arrays, axes[instance], half_lengths[instance], instance, prim, scratch, nearest[slot]
            )
            continue

        # The first corner and the edges from there, which are placed by themselves: far from zero they keep digits that
        # differences of placed corners would lose.
        face, base = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
        first, second, third = base + faces[face, 0], base + faces[face, 1], base + faces[face, 2]
        x, y, z = vertices[first, 0], vertices[first, 1], vertices[first, 2]
        ux, uy, uz = vertices[second, 0] - x, vertices[second, 1] - y, vertices[second, 2] - z
        vx, vy, vz = vertices[third, 0] - x, vertices[third, 1] - y, vertices[third, 2] - z

        # The corners as seen from the point, times a power of two.
        size, reach = 0.0, 0.0
        if arrays.is_lone:
            scale = arrays.scale[0]
            for axis in range(3):
                reach = max(reach, abs(points[index, axis] - centre[axis]))
            is_far = reach > far
            for axis in range(3):
                own = np.float64(points[index, axis])
                if is_far:
                    own = centre[axis] + (own - centre[axis]) * (far / reach)
                a[axis] = (vertices[first, axis] - own) * scale
                b[axis] = (vertices[second, axis] - own) * scale
                c[axis] = (vertices[third, axis] - own) * scale
        else:
            b[0], b[1], b[2] = place_vector(arrays, instance, ux, uy, uz)
            c[0], c[1], c[2] = place_vector(arrays, instance, vx, vy, vz)
            way[0], way[1], way[2] = place_point(arrays, instance, x, y, z)
            for axis in range(3):
                way[axis] -= points[index, axis]
                size = max(size, abs(b[axis]), abs(c[axis]))
                reach = max(reach, abs(way[axis]))
            is_far = reach > _FAR_PRIM_SHARE * size
            share = _FAR_PRIM_SHARE * size / reach if is_far else 1.0
            scale = power_of_two(-exponent_of(max(reach * share, size)))
            for axis in range(3):
                a[axis] = way[axis] * share * scale
                b[axis] = a[axis] + b[axis] * scale
                c[axis] = a[axis] + c[axis] * scale

        squared = closest_on_triangle(a, b, c, weights)
        x += weights[1] * ux + weights[2] * vx
        y += weights[1] * uy + weights[2] * vy
        z += weights[1] * uz + weights[2] * vz
        if not arrays.is_lone:
            x, y, z = place_point(arrays, instance, x, y, z)
        nearest[slot, 0], nearest[slot, 1], nearest[slot, 2] = x, y, z
        if is_far:
            distance[slot] = _far_distance(points[index], nearest[slot], reach)
        else:
            distance[slot] = np.sqrt(squared) / scale


@compiled(error_model="numpy")
def _close_to_sphere(point, arrays, axes, half_lengths, instance, prim, scratch, nearest):
    """Write the closest point of the ellipsoid that a placed sphere is, and return its distance."""
    sphere = arrays.first_sphere[arrays.geometry_id[instance]] + prim
    x, y, z, radius = (
        arrays.spheres[sphere, 0], arrays.spheres[sphere, 1], arrays.spheres[sphere, 2], arrays.spheres[sphere, 3]
    )  # fmt: skip
    position, lengths, signs, shares, way = scratch
    nearest[0], nearest[1], nearest[2] = place_point(arrays, instance, x, y, z)
    size, reach = 0.0, 0.0
    for axis in range(3):
        way[axis] = point[axis] - nearest[axis]
        reach = max(reach, abs(way[axis]))
        size = max(size, half_lengths[axis] * radius)
    is_far = reach > _FAR_PRIM_SHARE * size
    share = _FAR_PRIM_SHARE * size / reach if is_far else 1.0
    exponent = exponent_of(size)
    for row in range(3):
        along = axes[row, 0] * way[0] + axes[row, 1] * way[1] + axes[row, 2] * way[2]
        signs[row] = -1.0 if along < 0.0 else 1.0
        position[row] = times_power_of_two(abs(along) * share, -exponent)
        lengths[row] = times_power_of_two(half_lengths[row] * radius, -exponent)
    find_shares(position, lengths, shares)
    squared = 0.0
    for row in range(3):
        away = position[row] - shares[row] * lengths[row]
        squared += away * away
        for axis in range(3):
            nearest[axis] += signs[row] * shares[row] * (half_lengths[row] * radius) * axes[row, axis]
    return _far_distance(point, nearest, reach) if is_far else times_power_of_two(np.sqrt(squared), exponent)


@compiled(error_model="numpy")
def _far_distance(point, nearest, reach):
    """Return the distance of a point from its closest one, whose square may leave float64, given about its size."""
    squared = 0.0
    for axis in range(3):
        away = (nearest[axis] - point[axis]) / reach
        squared += away * away
    return reach * np.sqrt(squared)

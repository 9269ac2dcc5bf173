"""The oracle for points in scenes: the nearest point of the surface, and whether a point is inside, in float64.

Every primitive of every instance against every point. Distances are those of the world, also where a transform shears:
triangles are placed in the world, and a placed sphere is an ellipsoid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clbvh.geometry.mesh import Mesh
from clbvh.structs import NO_PRIM
from clbvh.support.compiled import compiled
from clbvh.support.loop_functions import cross, dot, subtract
from clbvh.trace.check.instances import Instance, SceneState, Tolerance, find_instances, world_radius
from clbvh.trace.check.intersections import Rays, find_intersections

# Directions along which crossings are counted, one after the other, until one meets no edge.
_DIRECTIONS = np.array(
    [[0.2673, -0.8018, 0.5345], [-0.6396, 0.4264, 0.6396], [0.9113, 0.3645, -0.1913], [-0.3015, -0.3015, -0.9045]]
)


class NearestPoints(NamedTuple):
    """The nearest primitive for each point.

    Attributes
    ----------
    distance : (n,) float64, world units
        Infinite where there is nothing.
    point : (n, 3) float64, world
        NaN where there is nothing.
    instance_id, geometry_id, prim_id : (n,) int64
        At equal distance the smaller (instance, primitive). -1 where there is nothing.
    slack : (n,) float64, world units
        The device chooses in float32, and may choose another primitive that is farther away by up to this much.
    """

    distance: NDArray[np.float64]
    point: NDArray[np.float64]
    instance_id: NDArray[np.int64]
    geometry_id: NDArray[np.int64]
    prim_id: NDArray[np.int64]
    slack: NDArray[np.float64]


class InstancePoints(NamedTuple):
    """How points lie to each instance, in arrays of (points, instances).

    Attributes
    ----------
    distance, slack : (n, m) float64, world units
    is_inside, is_decided : (n, m) bool
        Whether the instance contains the point, and whether float32 must say so.
    """

    distance: NDArray[np.float64]
    slack: NDArray[np.float64]
    is_inside: NDArray[np.bool_]
    is_decided: NDArray[np.bool_]


class ScenePoints:
    """Answers about points in one scene, by every primitive.

    Parameters
    ----------
    scene : SceneState
        Or anything with its fields `shapes`, `geometry_ids`, `transforms` and `masks`.
    mask : int, optional
        Instances whose mask shares no bit with it do not count.
    blur : Tolerance, optional
        How far the device may be off.
    """

    def __init__(self, scene: SceneState, mask: int = 0xFFFFFFFF, blur: Tolerance | None = None) -> None:
        self._scene = scene
        self._blur = blur or Tolerance()
        all_placements = find_instances(scene)
        self._size = world_radius(all_placements) if all_placements else 0.0
        self._all_placements = all_placements
        self._placements = [placed for placed in all_placements if placed.mask & mask]
        self._mask = mask

    def closest_point(self, points: ArrayLike) -> NearestPoints:
        """Return the nearest primitive of all visible instances for (n, 3) points; degenerate triangles do not count.

        The points of the surface are those of the file, in float64.
        """
        given = np.asarray(points, np.float64).reshape(-1, 3)
        instance_id, geometry_id, prim_id = np.full((3, len(given)), NO_PRIM)
        best = NearestPoints(
            np.full(len(given), np.inf), np.full(given.shape, np.nan), instance_id, geometry_id, prim_id,
            np.zeros(len(given)),
        )  # fmt: skip
        distances = np.empty((len(self._placements), len(given)))
        slacks = np.empty_like(distances)
        for row, placed in enumerate(self._placements):
            distances[row], point, prim = _find_nearest(placed, given)
            slacks[row] = self._slack(placed, given)
            is_nearer = distances[row] < best.distance
            best.distance[is_nearer], best.point[is_nearer] = distances[row, is_nearer], point[is_nearer]
            best.instance_id[is_nearer], best.geometry_id[is_nearer] = placed.instance_id, placed.geometry_id
            best.prim_id[is_nearer] = prim[is_nearer]
            best.slack[is_nearer] = slacks[row, is_nearer]

        # The device may be wrong by the slack of the nearest instance, and by that of another that seems as near.
        least = best.distance + best.slack
        seems_near = distances - slacks <= least
        best.slack[:] += np.where(seems_near, slacks, 0.0).max(axis=0, initial=0.0)
        return best

    def distance_to(self, points: ArrayLike, instance_ids: ArrayLike, prim_ids: ArrayLike) -> NDArray[np.float64]:
        """Return the distances of (n, 3) points from one primitive each; NaN where the ids are -1."""
        given = np.asarray(points, np.float64).reshape(-1, 3)
        instances, prims = (np.asarray(ids, np.int64).reshape(-1) for ids in (instance_ids, prim_ids))
        distance = np.full(len(given), np.nan)
        for placed in self._placements:
            for index in np.flatnonzero(instances == placed.instance_id):
                distance[index] = _find_nearest(placed, given[index : index + 1], int(prims[index]))[0][0]
        return distance

    def contains(self, points: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return whether the union of the visible instances contains each point, and whether that is decided."""
        lie = self.by_instance(points)
        is_inside = np.logical_or.reduce(lie.is_inside, axis=1)
        is_surely_inside = np.logical_or.reduce(lie.is_inside & lie.is_decided, axis=1)
        return is_inside, is_surely_inside | np.logical_and.reduce(lie.is_decided, axis=1)

    def signed_distance(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
        """Return the signed distance from the surface of the union, whether its sign is decided, and its slack.

        Outside it is minus the distance from the nearest surface. Inside it is the greatest of the distances from the
        surfaces of those instances that contain the point: a lower bound of the distance from the surface of the union.
        """
        lie = self.by_instance(points)
        if lie.distance.shape[1] == 0:
            nothing = np.zeros(len(lie.distance))
            return nothing - np.inf, np.ones(len(nothing), np.bool_), nothing
        inside = np.where(lie.is_inside, lie.distance, -np.inf).max(axis=1)
        is_inside = np.logical_or.reduce(lie.is_inside, axis=1)
        distance = np.where(is_inside, inside, -lie.distance.min(axis=1))
        # Where a point is inside, an instance that cannot be decided may have the greatest distance or not.
        could_matter = ~lie.is_decided & (~is_inside[:, None] | (lie.distance + lie.slack >= inside[:, None]))
        # Those instances count whose distance the device may choose.
        least = (lie.distance + lie.slack).min(axis=1, keepdims=True)
        counts = np.where(is_inside[:, None], lie.is_inside | ~lie.is_decided, lie.distance - lie.slack <= least)
        slack = 2.0 * np.where(counts, lie.slack, 0.0).max(axis=1)
        return distance, ~np.logical_or.reduce(could_matter, axis=1), slack

    def by_instance(self, points: ArrayLike) -> InstancePoints:
        """Return how (n, 3) points lie to each visible instance.

        A mesh contains a point from which a ray crosses it an odd number of times; of spheres, one must contain it.
        """
        given = np.asarray(points, np.float64).reshape(-1, 3)
        shape = len(given), len(self._placements)
        lie = InstancePoints(np.empty(shape), np.empty(shape), np.zeros(shape, np.bool_), np.zeros(shape, np.bool_))
        for column, placed in enumerate(self._placements):
            lie.distance[:, column] = _find_nearest(placed, given)[0]
            lie.slack[:, column] = self._slack(placed, given)
            if not isinstance(placed.shape, Mesh):
                lie.is_inside[:, column] = _are_in_spheres(placed, given)
                lie.is_decided[:, column] = True
        self._count_parities(given, lie)
        # Next to the surface, the device may see the point on its other side.
        lie.is_decided[lie.distance <= lie.slack] = False
        return lie

    def _count_parities(self, points: NDArray[np.float64], lie: InstancePoints) -> None:
        """Write whether meshes contain the points, by the first direction along which all crossings are sure."""
        count = len(points)
        for direction in _DIRECTIONS:
            if count == 0 or lie.is_decided.all():
                return
            rays = Rays.make(points, direction[None], mask=self._mask)
            crossings = find_intersections(self._scene, rays, self._blur, self._all_placements)
            ray_id = crossings.ray_id
            for column, placed in enumerate(self._placements):
                if not isinstance(placed.shape, Mesh):
                    continue
                mine = crossings.instance_id == placed.instance_id
                found = np.bincount(ray_id[mine], minlength=count)
                is_sure = np.bincount(ray_id[mine & crossings.is_sure], minlength=count) == found
                is_new = is_sure & ~lie.is_decided[:, column]
                lie.is_inside[is_new, column] = found[is_new] % 2 == 1
                lie.is_decided[is_new, column] = True

    def _slack(self, placed: Instance, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much float32 may be wrong about the distance of points from an instance, world units.

        Without an advance to before it: a far point's distance is a large number.
        """
        distance = np.linalg.norm(points - placed.centre, axis=1)
        growth = placed.growth if isinstance(placed.shape, Mesh) else np.linalg.norm(placed.to_world, 2) * np.sqrt(3.0)
        growth = max(growth, float(np.linalg.norm(placed.to_world, 2)) * placed.local_growth)
        reach = distance + placed.radius * placed.unit
        return self._blur.entering * growth * reach + self._blur.pair * (distance + self._size)


def _find_nearest(
    placed: Instance, points: NDArray[np.float64], prim: int = NO_PRIM
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return distance, point and primitive of one instance for each point; of one primitive, if it is given."""
    seen = placed.to_unit(points)
    shape = placed.shape
    found = np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), np.int64)
    if isinstance(shape, Mesh):
        corners = (shape.vertices - shape.origin) * shape.scale @ placed.to_world.T
        faces = np.arange(shape.face_count) if prim == NO_PRIM else np.array([prim])
        _search_triangles(corners, shape.faces, shape.degenerate_faces, faces, seen, found)
    else:
        # A sphere becomes an ellipsoid with these axes.
        turn, stretches, _ = np.linalg.svd(placed.to_world)
        centres = (shape.centres - shape.origin) * shape.scale @ placed.to_world.T
        spheres = np.arange(shape.prim_count) if prim == NO_PRIM else np.array([prim])
        _search_ellipsoids(centres @ turn, shape.radii * shape.scale, stretches, spheres, seen @ turn, found)
        found[1][:] = found[1] @ turn.T
    distance, point, prim_id = found
    return distance * placed.unit, placed.centre + point * placed.unit, prim_id


def _are_in_spheres(placed: Instance, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether any sphere of an instance contains each point."""
    shape = placed.shape
    assert not isinstance(shape, Mesh)
    local = placed.to_unit(points) @ placed.to_local.T
    centres, radii = (shape.centres - shape.origin) * shape.scale, shape.radii * shape.scale
    is_inside = np.zeros(len(points), np.bool_)
    for centre, radius in zip(centres, radii, strict=True):
        is_inside |= np.linalg.norm(local - centre, axis=1) < radius
    return is_inside


@compiled
def _search_triangles(corners, faces, degenerate, prims, points, found):
    distances, nearest, prim_ids = found
    for index in range(len(points)):
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        distances[index], prim_ids[index] = np.inf, NO_PRIM
        nearest[index, 0], nearest[index, 1], nearest[index, 2] = np.nan, np.nan, np.nan
        for prim in prims:
            if degenerate[prim]:
                continue
            a, b, c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
            to_x, to_y, to_z = nearest_on_triangle(
                (corners[a, 0] - x, corners[a, 1] - y, corners[a, 2] - z),
                (corners[b, 0] - x, corners[b, 1] - y, corners[b, 2] - z),
                (corners[c, 0] - x, corners[c, 1] - y, corners[c, 2] - z),
            )
            distance = np.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
            if distance < distances[index]:
                distances[index], prim_ids[index] = distance, prim
                nearest[index, 0], nearest[index, 1], nearest[index, 2] = x + to_x, y + to_y, z + to_z


@compiled
def _search_ellipsoids(centres, radii, stretches, prims, points, found):
    distances, nearest, prim_ids = found
    seen, axes, surface = np.empty(3), np.empty(3), np.empty(3)
    for index in range(len(points)):
        distances[index], prim_ids[index] = np.inf, NO_PRIM
        for prim in prims:
            for axis in range(3):
                seen[axis] = points[index, axis] - centres[prim, axis]
                axes[axis] = stretches[axis] * radii[prim]
            nearest_on_ellipsoid(axes, seen, surface)
            x, y, z = surface[0] - seen[0], surface[1] - seen[1], surface[2] - seen[2]
            distance = np.sqrt(x * x + y * y + z * z)
            if distance < distances[index]:
                distances[index], prim_ids[index] = distance, prim
                nearest[index, 0] = points[index, 0] + x
                nearest[index, 1] = points[index, 1] + y
                nearest[index, 2] = points[index, 2] + z


# Where the halving of an interval has come down to the pole.
_POLE = 1e-300


@compiled
def nearest_on_triangle(a, b, c):
    """Return the point of a triangle that is nearest to zero, as a tuple; the corners are tuples of 3 float64.

    The foot on the plane if it is inside, else the nearest point of the edges: slow, and nothing to get wrong.
    """
    nearest = _nearest_on_edge(a, b)
    for other in (_nearest_on_edge(b, c), _nearest_on_edge(c, a)):
        if dot(other, other) < dot(nearest, nearest):
            nearest = other
    ab, ac = subtract(b, a), subtract(c, a)
    normal = cross(ab, ac)
    square = dot(normal, normal)
    if square > 0.0:
        share = dot(normal, a) / square
        foot = (share * normal[0], share * normal[1], share * normal[2])
        to_a, to_b, to_c = subtract(a, foot), subtract(b, foot), subtract(c, foot)
        if (
            dot(normal, cross(to_a, to_b)) >= 0.0
            and dot(normal, cross(to_b, to_c)) >= 0.0
            and dot(normal, cross(to_c, to_a)) >= 0.0
        ):
            nearest = foot
    return nearest


@compiled
def _nearest_on_edge(a, b):
    way = subtract(b, a)
    square = dot(way, way)
    share = min(max(-dot(a, way) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return a[0] + share * way[0], a[1] + share * way[1], a[2] + share * way[2]


@compiled
def nearest_on_ellipsoid(axes, point, nearest):
    """Write the point of the surface of an ellipsoid that is nearest to a point.

    Parameters
    ----------
    axes : (3,) float64
        Half the lengths of the axes, which are the coordinate axes; above 0, in any order.
    point : (3,) float64
        Inside or outside, or on the surface.
    nearest : (3,) float64, written

    Notes
    -----
    The nearest point x is where ``point - x`` is along the normal: ``x_i = a_i^2 p_i / (s + a_i^2)`` with the greatest
    s for which x is on the surface. The sum of the squares of ``x_i / a_i`` falls with s, so halving an interval finds
    it (Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013). If the point is on the
    plane across the shortest axis, and near the centre, the sum stays below 1 down to the pole, where s is minus the
    square of that axis, and the rest of the way goes along it.
    """
    shortest = min(axes[0], axes[1], axes[2])
    # In units of the shortest axis, and s from the pole on, so that float64 has all digits of it there.
    low, high = 0.0, 1.0
    for axis in range(3):
        high += (axes[axis] / shortest) * abs(point[axis] / shortest)
    while True:
        middle = low + (high - low) / 2.0
        if middle in (low, high):
            break
        if _sum_of_squares(axes, point, shortest, middle) > 1.0:
            low = middle
        else:
            high = middle
    rest = 1.0
    for axis in range(3):
        share = _share(axes[axis], point[axis], shortest, high)
        nearest[axis] = share * axes[axis]
        rest -= share * share
    if high <= _POLE:
        for axis in range(3):
            if axes[axis] == shortest:
                nearest[axis] = np.sqrt(max(rest, 0.0)) * axes[axis]
                break


@compiled
def _share(half_axis, coordinate, shortest, s):
    """Return ``x_i / a_i``."""
    stretch = half_axis / shortest
    return stretch * (coordinate / shortest) / (s + (stretch - 1.0) * (stretch + 1.0))


@compiled
def _sum_of_squares(axes, point, shortest, s):
    one = _share(axes[0], point[0], shortest, s)
    other = _share(axes[1], point[1], shortest, s)
    third = _share(axes[2], point[2], shortest, s)
    return one * one + other * other + third * third

"""The oracle for points in scenes: all primitives against all points in float64, by slower ways than the tracer's."""

import numpy as np
import trimesh

from clbvh import Spheres
from clbvh.trace.check.instances import Tolerance, find_instances, world_radius

# Of distances in float64, as a share of the coordinates.
EXACT = 2.0**-44

# Halvings of the interval in which the closest point of an ellipsoid is searched.
_HALVINGS = 250


def distance_to_ellipsoid(points, centre, matrix):
    """The distance of points from the surface that a matrix makes of the sphere of radius 1 around zero, moved."""
    axes, lengths, _ = np.linalg.svd(matrix)
    position = np.abs((points - centre) @ axes)
    least = lengths[2]
    pulls, above = lengths * position / least**2, (lengths / least - 1) * (lengths / least + 1)

    def shares_at(shift):
        return np.divide(pulls, shift[:, None] + above, out=np.zeros_like(pulls), where=pulls > 0)

    low, high = np.zeros(len(points)), np.linalg.norm(pulls, axis=1)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_below = (shares_at(middle) ** 2).sum(axis=1) > 1
        low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
    shares = shares_at(high)
    # From the middle, the closest point is off the plane across the shortest axis.
    with np.errstate(divide="ignore"):
        middle_shares = shares_at(np.zeros(len(points)))
    rest = 1 - (middle_shares**2).sum(axis=1)
    is_middle = (pulls[:, 2] == 0) & (rest > 0)
    shares[is_middle] = middle_shares[is_middle]
    shares[is_middle, 2] = np.sqrt(rest[is_middle])
    shares /= np.linalg.norm(shares, axis=1, keepdims=True)
    return np.linalg.norm(position - shares * lengths, axis=1)


def distance_to_triangles(corners, points):
    """The distances of (n, 3) points from (m, 3, 3) triangles, as (n, m), by trimesh's formula."""
    count = len(points)
    nearest = trimesh.triangles.closest_point(np.tile(corners, (count, 1, 1)), np.repeat(points, len(corners), axis=0))
    return np.linalg.norm(nearest.reshape(count, -1, 3) - points[:, None], axis=2)


def distance_to_primitives(shape, transform, points):
    """The distances of (n, 3) points from the m primitives of a placed shape, as (n, m); inf from degenerate ones."""
    linear, offset = transform[:3, :3], transform[:3, 3]
    if isinstance(shape, Spheres):
        away = points[:, None] - (shape.centres @ linear.T + offset)
        in_radii = (away / shape.radii[:, None]).reshape(-1, 3)
        return distance_to_ellipsoid(in_radii, np.zeros(3), linear).reshape(len(points), -1) * shape.radii
    distance, is_seen = np.full((len(points), shape.face_count), np.inf), ~shape.degenerate_faces
    if is_seen.any():
        placed = (shape.vertices @ linear.T)[shape.faces[is_seen]]
        # The formula has tolerances, which suit triangles in a box of about this size.
        scale = 10 / np.abs(placed).max()
        distance[:, is_seen] = distance_to_triangles(placed * scale, (points - offset) * scale) / scale
    return distance


def is_in_shape(shape, transform, points):
    """Whether a placed closed shape contains points."""
    inside = (points - transform[:3, 3]) @ np.linalg.inv(transform[:3, :3]).T
    if isinstance(shape, Spheres):
        return (np.linalg.norm(inside[:, None] - shape.centres, axis=2) < shape.radii).any(axis=1)
    return wind(shape.vertices[shape.faces], inside) % 2 == 1


def wind(triangles, points):
    """How often closed triangles wind around points, without a sign (Van Oosterom and Strackee, 1983)."""
    turns = np.zeros(len(points))
    for corners in triangles:
        a, b, c = (corner - points for corner in corners)
        la, lb, lc = (np.linalg.norm(way, axis=1) for way in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        turns += np.arctan2(
            volume, la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        )
    return np.round(np.abs(turns) / (2 * np.pi)).astype(int)


class SceneDistances:
    """How points lie to all that is in the state of a scene; `seen` is bool that broadcasts to (points, instances)."""

    def __init__(self, state, points):
        self.state, self.points = state, points
        shapes = [state.shapes[geometry] for geometry in state.geometry_ids]
        self.prim_counts = [shape.prim_count for shape in shapes]
        placed = list(zip(shapes, state.transforms, strict=True))
        of_instances = [distance_to_primitives(*one, points) for one in placed]
        self.to_prims = np.concatenate(of_instances, axis=1)
        self.to_instances = np.stack([distance.min(axis=1) for distance in of_instances], axis=1)
        self.is_inside = np.stack([is_in_shape(*one, points) for one in placed], axis=1)
        self.reach = np.abs(points).max() + np.abs(state.transforms[:, :3]).max()

        # Float32 chooses the primitive, after the roundings of the placement.
        instances, blur = find_instances(state), Tolerance()
        away = np.stack([np.linalg.norm(points - one.centre, axis=1) for one in instances], axis=1)
        growth = np.array([max(one.growth, np.linalg.norm(one.to_world, 2) * one.local_growth) for one in instances])
        sizes = np.array([one.radius * one.unit for one in instances])
        self.slack = blur.entering * growth * (away + sizes) + blur.pair * (away + world_radius(instances))

    def column_of(self, instance_id, prim_id):
        """Where the primitive of an instance is among all."""
        return np.cumsum([0, *self.prim_counts])[instance_id] + prim_id

    def check_point(self, closest, seen=True):
        """Check what `closest_point` has found."""
        distance = np.where(seen, self.to_instances, np.inf)
        nearest = distance.min(axis=1)
        is_seen, row = np.isfinite(nearest), np.arange(len(nearest))
        for ids in (closest.prim_id, closest.instance_id, closest.geometry_id):
            np.testing.assert_array_equal(ids >= 0, is_seen)
            assert (ids[~is_seen] == -1).all()
        assert np.isposinf(closest.distance[~is_seen]).all()
        assert np.isnan(closest.point[~is_seen]).all()

        # Nothing is nearer, but for the choice in float32.
        error = closest.distance[is_seen] - nearest[is_seen]
        slack = 2 * np.where(distance - self.slack <= (nearest + self.slack.max(axis=1))[:, None], self.slack, 0)
        assert (error >= -EXACT * self.reach).all()
        assert (error <= slack.max(axis=1)[is_seen] + EXACT * self.reach).all()

        # The distance is that of the primitive that is named, and of the point.
        instance_id = closest.instance_id[is_seen]
        own = self.to_prims[row[is_seen], self.column_of(instance_id, closest.prim_id[is_seen])]
        away = np.linalg.norm(closest.point - self.points, axis=1)[is_seen]
        assert np.broadcast_to(seen, distance.shape)[row[is_seen], instance_id].all()
        for other in (own, away):
            np.testing.assert_allclose(closest.distance[is_seen], other, rtol=0, atol=EXACT * self.reach)
        np.testing.assert_array_equal(closest.geometry_id[is_seen], self.state.geometry_ids[instance_id])

    def check_insides(self, contains, signed, seen=True):
        """Check `contains` and `signed_distance` in closed shapes, off their surfaces; return how many are sure."""
        distance = np.where(seen, self.to_instances, np.inf)
        contained, nearest = self.is_inside & seen, distance.min(axis=1)
        is_inside, is_seen = contained.any(axis=1), np.isfinite(nearest)
        assert not contains[~is_seen].any()
        assert np.isneginf(signed[~is_seen]).all()
        is_sure = (distance > self.slack).all(axis=1) & is_seen
        np.testing.assert_array_equal(contains[is_sure], is_inside[is_sure])

        # Inside, it is the largest distance from the surface of an instance that contains the point.
        depth = np.where(contained, self.to_instances, -np.inf).max(axis=1)
        expected = np.where(is_inside, depth, -nearest)
        is_near = distance - self.slack <= (nearest + self.slack.max(axis=1))[:, None]
        slack = 2 * np.where(np.where(is_inside[:, None], contained, is_near), self.slack, 0).max(axis=1)
        assert (np.abs(signed[is_sure] - expected[is_sure]) <= slack[is_sure] + EXACT * self.reach).all()
        return np.count_nonzero(is_sure)

    def check_points(self, closest, k, seen=True):
        """Check what `closest_points` has found: the k nearest primitives, each once."""
        seen_prims = np.repeat(np.broadcast_to(seen, self.to_instances.shape), self.prim_counts, axis=1)
        expected = np.sort(np.where(seen_prims, self.to_prims, np.inf), axis=1)[:, :k]
        is_found = np.isfinite(expected)
        for ids in (closest.prim_id, closest.instance_id, closest.geometry_id):
            np.testing.assert_array_equal(ids >= 0, is_found)
        np.testing.assert_allclose(closest.distance, expected, rtol=0, atol=EXACT * self.reach)
        assert (closest.distance[:, 1:] >= closest.distance[:, :-1]).all()
        column = np.where(is_found, self.column_of(closest.instance_id, closest.prim_id), -1 - np.arange(k))
        own = np.where(is_found, np.take_along_axis(self.to_prims, np.maximum(column, 0), axis=1), np.inf)
        np.testing.assert_allclose(own, expected, rtol=0, atol=EXACT * self.reach)
        assert (np.diff(np.sort(column, axis=1)) != 0).all()
        away = np.linalg.norm(closest.point - self.points[:, None], axis=2)
        np.testing.assert_allclose(away[is_found], expected[is_found], rtol=0, atol=EXACT * self.reach)


def points_around(state, generator, count=40):
    """Points anywhere, and on the surfaces of all instances, at corners and edges, and near them."""
    points = [generator.normal(size=(count, 3)) * 4]
    for geometry, transform in zip(state.geometry_ids, state.transforms, strict=True):
        shape = state.shapes[geometry]
        chosen = generator.integers(0, shape.prim_count, count // 4)
        if isinstance(shape, Spheres):
            outwards = generator.normal(size=(len(chosen), 3))
            outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
            on = shape.centres[chosen] + outwards * shape.radii[chosen, None] * generator.choice(
                [0, 0.5, 1], (len(chosen), 1)
            )
        else:
            weights = np.array([[1, 0, 0], [1 / 2, 1 / 2, 0], [1 / 3, 1 / 3, 1 / 3]])[
                generator.integers(0, 3, len(chosen))
            ]
            on = (weights[:, :, None] * shape.vertices[shape.faces[chosen]]).sum(axis=1)
        placed = on @ transform[:3, :3].T + transform[:3, 3]
        points += [placed, placed + generator.normal(size=placed.shape) * 0.01 * np.abs(transform[:3, :3]).max()]
    return np.concatenate(points)

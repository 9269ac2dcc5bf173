"""Distances from the instances of a scene, and which of them contain a point, by slower ways in float64."""

import numpy as np

from clbvh import Spheres

from .nearest_point import distance_to_triangles

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


def distance_to_instance(shape, transform, points):
    """The distance of points from the surface of a placed shape."""
    linear, offset = transform[:3, :3], transform[:3, 3]
    if isinstance(shape, Spheres):
        placed = zip(shape.centres @ linear.T + offset, shape.radii, strict=True)
        return np.min([distance_to_ellipsoid(points, centre, linear * radius) for centre, radius in placed], axis=0)
    placed = (shape.vertices @ linear.T)[shape.faces[~shape.degenerate_faces]]
    # The formula has tolerances, which suit triangles in a box of about this size.
    scale = 10 / np.abs(placed).max()
    return distance_to_triangles(placed * scale, (points - offset) * scale) / scale


def is_in_instance(shape, transform, points):
    """Whether a placed closed shape contains points."""
    inside = (points - transform[:3, 3]) @ np.linalg.inv(transform[:3, :3]).T
    if isinstance(shape, Spheres):
        away = np.linalg.norm(inside[:, None] - shape.centres, axis=2)
        return (away < shape.radii).any(axis=1)
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
    """The distances of points from all instances of a scene, (instances, points), and which ones contain them."""

    def __init__(self, scene, points):
        state = scene.snapshot()
        placed = [
            (state.shapes[geometry], transform)
            for geometry, transform in zip(state.geometry_ids, state.transforms, strict=True)
        ]
        self.distance = np.array([distance_to_instance(*of, points) for of in placed])
        self.inside = np.array([is_in_instance(*of, points) for of in placed])

    def closest(self, seen=True):
        """The distance from the nearest instance of those seen: bool that broadcasts to (instances, points)."""
        return np.where(seen, self.distance, np.inf).min(axis=0)

    def contains(self, seen=True):
        """Whether an instance of those seen contains each point."""
        return (self.inside & seen).any(axis=0)

    def signed(self, seen=True):
        """The largest distance from the surfaces of instances around each point; minus the distance outside."""
        depth = np.where(self.inside & seen, self.distance, -np.inf).max(axis=0)
        return np.where(self.contains(seen), depth, -self.closest(seen))

"""The coordinates of points on spheres, and the points that come back from them."""

import itertools
import math

import numpy as np
import pytest

from clbvh.support.compiled import compiled
from clbvh.trace.hits.spheres import sphere_point, sphere_uv


@compiled
def _round_trip(points, coordinates, back):
    for point in range(len(points)):
        u, v = sphere_uv(points[point, 0], points[point, 1], points[point, 2])
        coordinates[point, 0], coordinates[point, 1] = u, v
        back[point, 0], back[point, 1], back[point, 2] = sphere_point(u, v)


def round_trip(points):
    coordinates, back = np.empty((len(points), 2)), np.empty((len(points), 3))
    _round_trip(points, coordinates, back)
    return coordinates, back


def exact_distances(points, back):
    """Distances in long double between unit vectors and points on the unit sphere."""
    exact = points.astype(np.longdouble)
    exact /= np.sqrt((exact**2).sum(axis=1, keepdims=True))
    return np.sqrt(((exact - back) ** 2).sum(axis=1)).astype(np.float64)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("width", [1.0, 1e-3, 1e-8, 1e-15, 1e-30, 1e-200])
def test_points_come_back_everywhere_and_next_to_poles_and_seam(width, seed):
    generator = np.random.default_rng(seed)
    near_pole = generator.normal(size=(20_000, 3)) * [width, width, 1]
    near_seam = np.abs(generator.normal(size=(20_000, 3))) * [1, -width, 1]
    points = np.concatenate((near_pole, near_seam))
    points /= np.sqrt((points**2).sum(axis=1, keepdims=True))
    coordinates, back = round_trip(points)
    assert exact_distances(points, back).max() < 1e-15
    assert (coordinates >= 0).all()
    assert (coordinates[:, 0] < 1).all()
    assert (coordinates[:, 1] <= 1).all()
    assert np.abs((back**2).sum(axis=1) - 1).max() < 1e-15


def test_points_on_the_axes_are_exact():
    axes = np.concatenate((np.eye(3), -np.eye(3)))
    coordinates, back = round_trip(axes)
    np.testing.assert_array_equal(back, axes)
    expected = [[0, 0.5], [0.25, 0.5], [0, 0], [0.5, 0.5], [0.75, 0.5], [0, 1]]
    np.testing.assert_array_equal(coordinates, expected)


def test_signed_zeros_are_points_too():
    for x, y, z in itertools.product((0.0, -0.0), (0.0, -0.0), (1.0, -1.0)):
        u, v = sphere_uv(x, y, z)
        assert 0 <= u < 1
        assert v == (z < 0)


def test_the_angles_are_those_of_the_formula():
    azimuth, polar = 4.0, 2.5
    point = (math.cos(azimuth) * math.sin(polar), math.sin(azimuth) * math.sin(polar), math.cos(polar))
    assert sphere_uv(*point) == pytest.approx((azimuth / (2 * math.pi), polar / math.pi), abs=1e-15)

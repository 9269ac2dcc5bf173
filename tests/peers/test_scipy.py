"""Balls of hardly any size against scipy's tree of points, which is exact in float64."""

import numpy as np
import pytest

import clbvh

spatial = pytest.importorskip("scipy.spatial", reason="scipy is not installed: it is in the extra `peers`")

RADIUS = 1e-12


@pytest.mark.parametrize("count", [10, 1000, 30_000])
def test_nearest_neighbours(count):
    generator = np.random.default_rng([1490, count])
    centres, points = generator.normal(size=(count, 3)), generator.normal(size=(1000, 3))
    distance, index = spatial.cKDTree(centres).query(points, 8)
    with clbvh.Tracer(clbvh.Scene(clbvh.Spheres(centres, np.full(count, RADIUS)))) as tracer:
        closest = tracer.closest_points(points, 8)
    np.testing.assert_array_equal(closest.prim_id, index)
    np.testing.assert_allclose(closest.distance, distance - RADIUS, rtol=0, atol=1e-14)

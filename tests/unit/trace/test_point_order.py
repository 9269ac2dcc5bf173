"""The order of points: each comes once, neighbours are close, and no answer depends on it."""

import numpy as np
import pytest

from clbvh.support.host_threads import HostThreads
from clbvh.trace.points import pack as point_order
from clbvh.trace.points.pack import find_point_order
from clbvh.trace.world.tree_box import TreeBox

from ...rays import hard_rays

COUNT = 40_000


def order_of(points, half=(1.0, 1.0, 1.0), centre=(0.0, 0.0, 0.0), threads=None):
    with HostThreads(threads) as opened:
        return find_point_order(points, TreeBox(np.array(centre), 1.0, np.array(half)), opened)


def steps(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_neighbours_are_close(dtype):
    points = np.random.default_rng(1).uniform(-1, 1, (COUNT, 3)).astype(dtype)
    order = order_of(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    # About COUNT ** (1 / 3) = 34 points lie along each axis.
    assert steps(points[order]) < steps(points) / 15
    assert order.tobytes() == order_of(points, threads=3).tobytes()


@pytest.mark.parametrize("half", [(1, 0, 1), (0, 0, 0), (1e-30, 1e30, 1)], ids=str)
def test_points_of_any_place_and_kind_come_once(half):
    generator = np.random.default_rng(2)
    points = generator.normal(size=(COUNT, 3)) * 10.0 ** generator.uniform(-40, 40, (COUNT, 1))
    points[::7], points[1::7, 1], points[2::7, 2] = 0.0, np.nan, np.inf
    np.testing.assert_array_equal(np.sort(order_of(points, half)), np.arange(COUNT))


def test_few_points_stay_as_they_are():
    points = np.random.default_rng(3).uniform(-1, 1, (point_order.LEAST_POINTS - 1, 3))
    np.testing.assert_array_equal(order_of(points), np.arange(len(points)))
    np.testing.assert_array_equal(order_of(points[:0]), [])


def test_no_answer_depends_on_it(tracer, mesh, monkeypatch):
    points = hard_rays(mesh, 3000, np.random.default_rng(4))[0]
    expected = tracer.closest_point(points)
    monkeypatch.setattr(point_order, "LEAST_POINTS", 1)
    for obtained, given in zip(tracer.closest_point(points), expected, strict=True):
        assert obtained.tobytes() == given.tobytes()


def test_the_first_bad_point_is_named(tracer, monkeypatch):
    monkeypatch.setattr(point_order, "LEAST_POINTS", 1)
    points = np.random.default_rng(5).uniform(-1, 1, (1000, 3))
    points[700, 2], points[800, 0] = np.nan, np.inf
    with pytest.raises(ValueError, match=r"points\[700\] is not finite"):
        tracer.closest_point(points)

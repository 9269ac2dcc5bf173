"""Outliers: few, small and far away; and what is none, however far it reaches."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.rendering.view_finder import LEAST_GAP, find_outliers


def cloud(seed, count=1000):
    return np.random.default_rng([81, seed]).random((count, 3))


def find(points, size=0.01):
    return np.flatnonzero(find_outliers(points, points + size, np.ones(len(points))))


@pytest.mark.parametrize("scale", [1e-30, 1, 1e30])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 1, 1), (-1, 0, 1)])
def test_a_far_one_is_found(direction, scale):
    points = cloud(0)
    points[123] += 20 * np.array(direction)
    assert find(points * scale, 0.01 * scale).tolist() == [123]


def test_several_on_all_sides_and_behind_each_other_are_found():
    points = cloud(1)
    points[:6] += 30 * np.concatenate((np.eye(3), -np.eye(3)))
    points[6:9] += [[33, 0, 0], [1e9, 0, 0], [-1e4, 50, 0]]
    assert find(points).tolist() == list(range(9))


def test_the_order_does_not_matter():
    points = cloud(2)
    points[:5] += [[50, 0, 0], [52, 0, 0], [0, -80, 0], [0, 0, 9], [0, 0, 900]]
    order = np.random.default_rng(3).permutation(len(points))
    assert set(order[find(points[order])]) == set(find(points)) == {0, 1, 2, 3, 4}


def test_many_or_large_ones_are_none():
    points = cloud(4)
    points[:11] += [90, 0, 0]  # 1.1 %
    assert not find(points).size
    points[:2] -= [90, 0, 0]
    assert find(points).size == 9
    sizes = np.full((len(points), 1), 0.01)
    sizes[5] = 0.05
    assert not find(points, sizes).size


def test_the_gap_that_counts():
    points = cloud(5) * [1, 0.5, 0.2]
    diagonal = np.linalg.norm(np.ptp(points[1:], axis=0) + 0.01)
    end = points[1:, 0].max() + 0.01
    points[0] = [end + 0.99 * LEAST_GAP * diagonal, 0.2, 0.1]
    assert not find(points).size
    points[0, 0] = end + 1.01 * LEAST_GAP * diagonal
    assert find(points).tolist() == [0]


def test_what_reaches_to_the_others_is_none():
    lower = cloud(6)
    upper = lower + 0.01
    upper[7, 1] = 1000  # a mast
    assert not find_outliers(lower, upper, np.ones(1000)).any()
    # And what is at its end, such as a flag, is none either.
    lower[8] += [0, 999, 0]
    upper[8] += [0, 999, 0]
    assert not find_outliers(lower, upper, np.ones(1000)).any()


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_few_things_have_no_outliers(count):
    points = cloud(7, count)
    points[0] += 1e6
    assert not find(points).size


def test_things_in_one_place_have_no_outliers():
    points = np.zeros((500, 3))
    points[0] = 9
    assert not find(points, 0.0).size


DISTRIBUTIONS = {
    "normal": lambda generator, n: generator.normal(size=n),
    "exponential": lambda generator, n: generator.exponential(size=n),
    # Of a spiral galaxy, whose stars thin out beyond ten times the size of the middle.
    "power": lambda generator, n: 10 * generator.random(n) ** 3,
}


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_outermost_of_a_galaxy_are_none(name, seed):
    generator = np.random.default_rng([82, seed])
    directions = generator.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    radii = DISTRIBUTIONS[name](generator, 5000)
    assert not find(directions * radii[:, None], 1e-3).size

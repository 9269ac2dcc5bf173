"""Equal points become one vertex, in the order of the file; different ones never do."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.geometry import topology as equal_points
from clbvh.geometry.topology import find_equal_points, find_points


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("seed", range(3))
def test_as_a_dictionary_would(dtype, seed):
    points = np.random.default_rng(seed).integers(0, 4, (200, 3)).astype(dtype) / 3
    numbers: dict[bytes, int] = {}
    expected = [numbers.setdefault(point.tobytes(), len(numbers)) for point in points]
    first, ids = find_equal_points(points)
    assert ids.tolist() == expected
    assert first.tolist() == [expected.index(number) for number in range(len(numbers))]


def test_only_equal_bits_are_equal():
    points = np.array([[0, 0, 1], [-0.0, 0, 1], [0, 0, np.nextafter(1, 2)], [0, 0, 1], [1, 0, 0]])
    assert find_equal_points(points).ids.tolist() == [0, 1, 2, 0, 3]
    assert find_points(points).ids.tolist() == [0, 0, 1, 0, 2]


def test_no_points():
    assert [array.shape for array in find_equal_points(np.empty((0, 3), np.float32))] == [(0,), (0,)]


def test_different_points_with_one_key(monkeypatch):
    monkeypatch.setattr(equal_points, "_FACTORS", np.array([1, 1, 1], np.uint64))
    points = np.array([[1, 2, 4], [4, 2, 1], [1, 2, 4], [2, 4, 1], [4, 2, 1]], np.float32)
    assert find_equal_points(points).ids.tolist() == [0, 1, 0, 2, 1]


def test_points_on_a_grid_have_keys_of_their_own():
    axis = np.arange(40, dtype=np.float64) / 8
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    keys = equal_points._find_keys(points.view(np.uint64))
    assert len(np.unique(keys)) == len(points)

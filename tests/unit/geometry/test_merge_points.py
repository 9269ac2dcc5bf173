"""Equal points become one vertex, in the order of the file; different ones never do."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.geometry.loading.merge_points import merge_points


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("seed", range(3))
def test_as_a_dictionary_would(dtype, seed):
    points = np.random.default_rng(seed).integers(0, 4, (200, 3)).astype(dtype) / 3
    numbers: dict[bytes, int] = {}
    expected = [numbers.setdefault(point.tobytes(), len(numbers)) for point in points]
    vertices, ids = merge_points(points)
    assert vertices.dtype == dtype
    assert ids.tolist() == expected
    assert (vertices[ids] == points).all()


def test_only_equal_bits_are_equal():
    points = np.array([[0, 0, 1], [-0.0, 0, 1], [0, 0, np.nextafter(1, 2)], [0, 0, 1], [1, 0, 0]])
    assert merge_points(points)[1].tolist() == [0, 1, 2, 0, 3]
    assert np.signbit(merge_points(points)[0][:2, 0]).tolist() == [False, True]


def test_no_points():
    vertices, ids = merge_points(np.empty((0, 3), np.float32))
    assert (vertices.shape, ids.shape) == ((0, 3), (0,))

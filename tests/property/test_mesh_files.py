"""Any convex polygon is covered exactly once; `tests/fuzz/` has damaged files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh.geometry.loading.file_mesh import cut_fans


@given(sizes=st.lists(st.integers(3, 12), min_size=1, max_size=6))
def test_a_fan_covers_a_convex_polygon_exactly_once(sizes):
    rings = [np.arange(size) * (2 * np.pi / size) for size in sizes]
    angles = np.concatenate(rings)
    x, y = np.cos(angles), np.sin(angles)
    faces = cut_fans(np.arange(len(angles)), np.array(sizes))
    assert len(faces) == sum(sizes) - 2 * len(sizes)

    (ax, bx, cx), (ay, by, cy) = x[faces].T, y[faces].T
    areas = ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(sum(size * np.sin(2 * np.pi / size) / 2 for size in sizes))

"""Polygons to triangles: order, winding."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import MeshError
from clbvh.geometry import face_limit
from clbvh.geometry.loading.polygons import cut_fans


def test_polygons_become_fans_where_they_stand():
    corners = np.array([0, 1, 2, 0, 2, 4, 6, 1, 2, 3, 4, 5, 5, 6, 7])
    faces = cut_fans(corners, np.array([3, 4, 5, 3]))
    assert faces.tolist() == [[0, 1, 2], [0, 2, 4], [0, 4, 6], [1, 2, 3], [1, 3, 4], [1, 4, 5], [5, 6, 7]]


def test_no_polygons_are_no_triangles():
    assert cut_fans(np.empty(0, int), np.empty(0, int)).shape == (0, 3)


@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_polygon_with_too_few_corners_is_named(size):
    with pytest.raises(MeshError, match=f"face 1 has {size} corners"):
        cut_fans(np.arange(3 + size), np.array([3, size]))


def test_triangles_that_do_not_fit_the_memory_are_refused_before_they_are_cut(monkeypatch):
    """A corner may be a single byte of a file, a triangle is 24 in memory."""
    monkeypatch.setattr(face_limit, "free_memory_bytes", lambda: 10_000)
    with pytest.raises(MeshError, match="98 triangles need about 0 MB of memory"):
        cut_fans(np.zeros(100, np.int64), np.array([100]))

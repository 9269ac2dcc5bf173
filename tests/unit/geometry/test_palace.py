"""The building: how many triangles a hall has, and that they are as unequal as they are meant to be."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import make_shape
from clbvh.geometry.shapes.palace import HALL_TRIANGLES


def measure(mesh):
    """Return the area of each triangle, and how many times as long as high it is."""
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return areas, longest**2 / (2 * areas)


@pytest.mark.parametrize("halls", [1, 3, 20])
def test_halls_are_whole(halls):
    assert make_shape("palace", triangles=halls * HALL_TRIANGLES, seed=halls).face_count == halls * HALL_TRIANGLES


@pytest.mark.parametrize("seed", [0, 1])
def test_huge_thin_and_tiny_triangles_are_mixed(seed):
    areas, slenderness = measure(make_shape("palace", triangles=100_000, seed=seed))
    assert areas.max() > 1e4 * np.median(areas)
    assert areas.max() > 1e5 * areas.min()
    assert np.quantile(slenderness, 0.9) > 10
    assert np.median(slenderness) < 4


def test_a_larger_palace_has_more_halls():
    small, large = (make_shape("palace", triangles=halls * HALL_TRIANGLES, seed=1) for halls in (6, 24))
    small_size, large_size = (np.ptp(mesh.vertices, axis=0) for mesh in (small, large))
    assert large_size[0] * large_size[2] > 2 * small_size[0] * small_size[2]
    assert large_size[1] == pytest.approx(small_size[1])

"""How deep two convex bodies are in each other: against the hull of all differences, and by formula."""

import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from clbvh import ConfigError
from clbvh.trace.clearance.depth import measure_overlap

BOX = trimesh.creation.box().vertices.view(np.ndarray)


def draw_bodies(seed, count):
    """Return pairs of clouds of points that overlap, some of them flat on one side."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        one, other = (random.normal(size=(random.integers(4, 40), 3)) for _ in range(2))
        one[:, 2] = np.where(random.random(len(one)) < 0.3, 1.0, one[:, 2])
        yield one, other + random.normal(size=3) * 0.3


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_depth_is_that_of_all_differences(size):
    found = 0
    for one, other in draw_bodies(5, 60):
        faces = ConvexHull((one[:, None] - other).reshape(-1, 3)).equations
        depth = -faces[:, 3].max()
        if depth < 0:
            continue  # they are apart
        found += 1
        overlap = measure_overlap(one * size, other * size)
        assert overlap.depth == pytest.approx(depth * size, rel=1e-9)
        assert np.linalg.norm(overlap.normal) == pytest.approx(1.0)
        # The other, moved by the depth, lies on the other side of a plane.
        assert (one @ overlap.normal).max() == pytest.approx((other @ overlap.normal).min() + depth, abs=1e-12)
        # The points are of the bodies, and that far apart.
        np.testing.assert_allclose(
            overlap.points[0] - overlap.points[1], depth * size * overlap.normal, atol=1e-12 * size
        )
        for cloud, point in zip((one, other), overlap.points / size, strict=True):
            hull = ConvexHull(cloud).equations
            assert (hull[:, :3] @ point + hull[:, 3]).max() < 1e-9
    assert found > 30


@pytest.mark.parametrize("aspect", [0.3, 0.1, 0.01, 1e-3])
def test_slender_bodies(aspect):
    octahedron = np.concatenate((np.eye(3), -np.eye(3))) * [aspect, aspect, 1]
    for number in range(1, 30):
        turn = trimesh.transformations.rotation_matrix(number, [1, 2, 3])[:3, :3]
        one, other = octahedron @ turn.T, octahedron @ turn.T + 0.2 * aspect * turn[:, 0]
        differences = (one[:, None] - other).reshape(-1, 3)
        depth = -ConvexHull(differences).equations[:, 3].max()
        assert measure_overlap(one, other).depth == pytest.approx(depth, rel=1e-9)


def test_bodies_that_are_not_deeper_than_a_least_depth_are_not_measured():
    assert measure_overlap(BOX, BOX + np.array([0.75, 0, 0]), 0.3) is None
    assert measure_overlap(BOX, BOX + np.array([0.75, 0, 0]), 0.2).depth == pytest.approx(0.25)
    assert measure_overlap(1e80 * BOX, 1e80 * BOX).depth == pytest.approx(1e80)


def test_of_equally_short_ways_the_first_is_taken():
    overlap = measure_overlap(BOX, BOX)
    assert overlap.depth == 1.0
    np.testing.assert_array_equal(overlap.normal, [-1, 0, 0])
    inner = measure_overlap(BOX, 0.2 * BOX)
    assert inner.depth == pytest.approx(0.6)
    assert measure_overlap(BOX, BOX + np.array([1, 0, 0])).depth == 0.0


def test_flat_bodies_in_one_plane_are_not_deep():
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.2, 0.3]))[:3, :3]
    plate = BOX * [1, 1, 0] @ turn.T
    overlap = measure_overlap(plate, plate + 0.3 * turn[:, 0])
    assert overlap.depth == pytest.approx(0.0, abs=1e-12)
    assert abs(overlap.normal @ turn[:, 2]) == pytest.approx(1.0)
    # A plate halfway in a box is parted from it along its own plane or across.
    assert measure_overlap(BOX, BOX * [4, 4, 0] + [0, 0, 0.4]).depth == pytest.approx(0.1)


def test_concentric_balls_of_many_faces_are_parted_by_their_diameter():
    ball = trimesh.creation.icosphere(3).vertices
    faces = ConvexHull(ball).equations
    # A ball of faces is its own mirror image, so the shortest way is twice the nearest face.
    assert measure_overlap(ball, ball).depth == pytest.approx(-2 * faces[:, 3].max())


def test_a_depth_without_scipy_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    with pytest.raises(ConfigError, match="pip install scipy"):
        measure_overlap(BOX, BOX)

"""Random points on surfaces: where they lie, how many per area, and the same for a seed."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import make_shape
from clbvh.errors import MeshError
from clbvh.scene.copies import DRAWS_PER_POINT, sample_surface

# Two triangles in the plane of x and y, of areas 1 and 3, and one without area between them.
VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [10, 0, 0], [12, 0, 0], [10, 3, 0]], float)
FACES = np.array([[0, 1, 2], [0, 1, 1], [3, 4, 5]], np.int32)


def draw(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((count, DRAWS_PER_POINT))


@pytest.mark.parametrize("seed", [0, 7])
def test_points_are_spread_by_area(seed):
    points, normals = sample_surface(VERTICES, FACES, draw(20_000, seed), name="two")
    is_first = points[:, 0] < 5
    assert is_first.mean() == pytest.approx(0.25, abs=0.02)
    assert (normals == [0, 0, 1]).all()
    # The mean of uniform points is the centroid.
    assert points[is_first].mean(axis=0) == pytest.approx(VERTICES[:3].mean(axis=0), abs=0.03)
    assert points[~is_first].mean(axis=0) == pytest.approx(VERTICES[3:].mean(axis=0), abs=0.03)


@pytest.mark.parametrize("seed", [3])
def test_points_lie_in_their_triangles(seed):
    (points, _) = sample_surface(VERTICES[:3], FACES[:1], draw(5000, seed), name="one")
    assert (points >= 0).all()
    assert (points[:, 0] / 2 + points[:, 1] <= 1 + 1e-12).all()
    # The whole triangle is reached, its far corners too.
    assert points.max(axis=0) == pytest.approx([2, 1, 0], abs=0.05)


@pytest.mark.parametrize("seed", [5])
def test_points_on_a_sphere_have_its_normals(seed):
    sphere = make_shape("icosphere", triangles=5120)
    points, normals = sample_surface(sphere.vertices, sphere.faces, draw(500, seed), name="ball")
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)
    assert (np.einsum("ij,ij->i", points, normals) > 0.99).all()


@pytest.mark.parametrize("seed", [2])
def test_more_points_keep_the_first_ones(seed):
    mesh = make_shape("terrain", triangles=500, seed=1)
    few, many = (sample_surface(mesh.vertices, mesh.faces, draw(n, seed), name="land")[0] for n in (10, 1000))
    assert few.tobytes() == many[:10].tobytes()


@pytest.mark.parametrize("size", [1e-170, 1e-30, 1e30, 1e150])
def test_the_size_of_a_surface_does_not_matter(size):
    draws = draw(200, 4)
    points, normals = sample_surface(VERTICES, FACES, draws, name="two")
    scaled, same_normals = sample_surface(VERTICES * size, FACES, draws, name="two")
    assert np.allclose(scaled / size, points)
    assert np.allclose(same_normals, normals)


def test_a_draw_next_to_one_meets_a_triangle_with_an_area():
    faces = np.array([[0, 1, 2], [0, 1, 1]], np.int32)
    draws = np.full((1, DRAWS_PER_POINT), np.nextafter(1.0, 0.0))
    _, normals = sample_surface(VERTICES, faces, draws, name="two")
    assert (normals == [0, 0, 1]).all()


@pytest.mark.parametrize("faces", [[[0, 1, 1]], [[0, 0, 0], [2, 2, 2]]])
def test_a_surface_without_area_is_refused(faces):
    with pytest.raises(MeshError, match="line: nothing can be scattered on a surface without area"):
        sample_surface(VERTICES, np.array(faces, np.int32), draw(1, 0), name="line")

"""Copies of objects: in grids, and scattered on surfaces, as many per area everywhere."""

import numpy as np
import pytest

from clbvh import MeshError, SceneError, Transform, make_shape
from clbvh.scene.copies import DRAWS_PER_POINT, MAX_COPIES, Grid, Scatter, sample_surface
from clbvh.support import memory

UP = (0.0, 1.0, 0.0)
# A square of side 4 at height 3, seen from above.
SQUARE = np.array([[-2, 3, -2], [-2, 3, 2], [2, 3, 2], [2, 3, -2]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
BASE = Transform(2, (0, 90, 0), (0, 0.5, 0)).matrix
# Two triangles in the plane of x and y, of areas 1 and 3, and one without area between them.
TWO = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [10, 0, 0], [12, 0, 0], [10, 3, 0]], float)
TWO_FACES = np.array([[0, 1, 2], [0, 1, 1], [3, 4, 5]], np.int32)


def sample(count, vertices=TWO, faces=TWO_FACES):
    return sample_surface(vertices, faces, np.random.default_rng(5).random((count, DRAWS_PER_POINT)), name="two")


def test_a_grid_stands_around_the_object_and_x_runs_fastest():
    copies = Grid((3, 1, 2), (2, 7, 10)).matrices(BASE)
    assert (copies[:, :3, :3] == BASE[:3, :3]).all()
    assert (copies[:, 3] == [0, 0, 0, 1]).all()
    places = [[-2, 0.5, -5], [0, 0.5, -5], [2, 0.5, -5], [-2, 0.5, 5], [0, 0.5, 5], [2, 0.5, 5]]
    assert copies[:, :3, 3] == pytest.approx(np.array(places))
    heights = Grid((2, 3, 2), (1, 10, 5)).matrices(np.eye(4))[:, 1, 3]
    assert heights.tolist() == [-10, -10, 0, 0, 10, 10] * 2


def test_upright_copies_stand_on_the_surface_scaled_within_the_limits():
    copies = Scatter("ground", 500, scale=(0.5, 2), turn=False).matrices(BASE, SQUARE, FACES, UP)
    scales = np.cbrt(np.linalg.det(copies[:, :3, :3])) / 2
    assert (scales.min(), scales.max()) == (pytest.approx(0.5, abs=0.05), pytest.approx(2, abs=0.05))
    assert np.allclose(copies[:, :3, :3], BASE[:3, :3] * scales[:, None, None])
    # The object's own lift is kept, and scaled with it.
    assert np.allclose(copies[:, 1, 3], 3 + 0.5 * scales)
    assert np.abs(copies[:, [0, 2], 3]).max() == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("up", [UP, (1, 2, 3), (0, 1e-200, 1e-200), (1e300, 0, -1e300)])
def test_turned_copies_stay_upright_and_face_all_ways(up):
    copies = Scatter("ground", 500, 1).matrices(np.eye(4), SQUARE, FACES, up)
    axis = np.array(up) / np.max(np.abs(up))
    axis /= np.linalg.norm(axis)
    assert np.allclose(copies[:, :3, :3] @ axis, axis)
    level = np.cross(axis, [0.3, 0.2, 0.9])
    level /= np.linalg.norm(level)
    assert (np.histogram((copies[:, :3, :3] @ level) @ level, bins=4, range=(-1, 1))[0] > 50).all()


def test_aligned_copies_point_along_the_normals():
    ball = make_shape("icosphere", triangles=5120)
    copies = Scatter("ball", 2000, 5, align="normal").matrices(np.eye(4), ball.vertices, ball.faces, UP)
    linear = copies[:, :3, :3]
    assert np.allclose(linear @ linear.transpose(0, 2, 1), np.eye(3))
    assert np.allclose(np.linalg.det(linear), 1)
    assert (np.einsum("ij,ij->i", linear @ UP, copies[:, :3, 3]) > 0.99).all()


@pytest.mark.parametrize("tilt", [0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_a_normal_that_points_down_turns_the_copy_over(tilt):
    down = SQUARE.copy()
    down[2:, 1] += tilt
    copies = Scatter("roof", 3, align="normal", turn=False).matrices(np.eye(4), down, FACES[:, ::-1], UP)
    linear = copies[:, :3, :3]
    assert np.allclose(linear @ linear.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(linear), 1)
    normal = np.cross(down[2] - down[0], down[1] - down[0])
    assert np.allclose(linear @ UP, normal / np.linalg.norm(normal), atol=1e-9)


def test_a_seed_gives_the_same_bytes_and_more_copies_keep_the_first_ones():
    def scatter(count, seed):
        return Scatter("g", count, seed, (0.5, 2), "normal").matrices(BASE, SQUARE, FACES, UP)

    assert scatter(1000, 3)[:100].tobytes() == scatter(100, 3).tobytes() != scatter(100, 4).tobytes()


def test_points_are_spread_by_area_and_lie_in_their_triangles():
    points, normals = sample(20_000)
    is_first = points[:, 0] < 5
    assert is_first.mean() == pytest.approx(0.25, abs=0.02)
    assert (normals == [0, 0, 1]).all()
    assert (points[is_first, 0] / 2 + points[is_first, 1] <= 1 + 1e-12).all()
    # The mean of uniform points is the centroid.
    assert points[is_first].mean(axis=0) == pytest.approx(TWO[:3].mean(axis=0), abs=0.03)
    assert points[~is_first].mean(axis=0) == pytest.approx(TWO[3:].mean(axis=0), abs=0.03)


@pytest.mark.parametrize("size", [1e-170, 1e-30, 1e30, 1e150])
def test_the_size_of_a_surface_does_not_matter(size):
    points, normals = sample(200)
    scaled, same_normals = sample(200, TWO * size)
    assert np.allclose(scaled / size, points)
    assert np.allclose(same_normals, normals)


def test_what_cannot_be_repeated_is_refused(monkeypatch):
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1e8)
    for make, message in (
        (lambda: Grid((10**6, 10**6, 10**6), (1, 1, 1)), "1,000,000,000,000,000,000 copies are too many"),
        (lambda: Scatter("g", MAX_COPIES + 1), "1,000,001 copies are too many: the limit is 1,000,000"),
        (lambda: Scatter("g", 900_000), "900,000 copies need about 900 MB of memory, but 100 MB are free"),
        (lambda: Scatter("g", 1, scale=(0, 1)), "scale must be above 0, and the smallest before the largest, not 0, 1"),
        (lambda: Scatter("g", 1, align="sideways"), "align must be one of up, normal, not 'sideways'"),
        (lambda: Scatter("g", 3).matrices(np.eye(4), SQUARE, FACES, (0, 0, 0)), "up must not be zero"),
    ):
        with pytest.raises(SceneError, match=message):
            make()
    with pytest.raises(MeshError, match="two: nothing can be scattered on a surface without area"):
        sample(1, faces=TWO_FACES[1:2])

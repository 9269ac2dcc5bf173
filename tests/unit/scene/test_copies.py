"""Copies of objects: where they stand, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import make_shape
from clbvh.errors import SceneError
from clbvh.scene.copies import MAX_COPIES, Grid, Scatter
from clbvh.scene.transforms import Transform
from clbvh.support import memory

UP = (0.0, 1.0, 0.0)
# A square of side 4 at height 3, seen from above.
SQUARE = np.array([[-2, 3, -2], [-2, 3, 2], [2, 3, 2], [2, 3, -2]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
BASE = Transform(2, (0, 90, 0), (0, 0.5, 0)).matrix


def test_a_grid_stands_around_the_object():
    copies = Grid((3, 1, 2), (2, 7, 10)).matrices(BASE)
    assert copies.shape == (6, 4, 4)
    assert (copies[:, :3, :3] == BASE[:3, :3]).all()
    assert (copies[:, 3] == [0, 0, 0, 1]).all()
    places = [[-2, 0.5, -5], [0, 0.5, -5], [2, 0.5, -5], [-2, 0.5, 5], [0, 0.5, 5], [2, 0.5, 5]]
    assert copies[:, :3, 3] == pytest.approx(np.array(places, float))


def test_x_runs_fastest_and_z_slowest():
    x, y, z = Grid((2, 3, 4), (1, 10, 100)).matrices(np.eye(4))[:, :3, 3].T
    order = np.argsort(x + y + z)
    assert (order == np.arange(24)).all()


def test_a_grid_of_one_is_the_object():
    assert (Grid((1, 1, 1), (2, 7, 10)).matrices(BASE) == BASE).all()


@pytest.mark.parametrize("seed", [0, 11])
def test_upright_copies_stand_on_the_surface(seed):
    copies = Scatter("ground", 500, seed, turn=False).matrices(BASE, SQUARE, FACES, UP)
    assert np.allclose(copies[:, :3, :3], BASE[:3, :3])
    # The object's own lift is kept.
    assert np.allclose(copies[:, 1, 3], 3.5)
    assert np.abs(copies[:, [0, 2], 3]).max() == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("seed", [0, 11])
def test_copies_are_scaled_within_the_limits(seed):
    copies = Scatter("ground", 500, seed, scale=(0.5, 2)).matrices(BASE, SQUARE, FACES, UP)
    scales = np.cbrt(np.linalg.det(copies[:, :3, :3])) / 2
    assert scales.min() == pytest.approx(0.5, abs=0.05)
    assert scales.max() == pytest.approx(2, abs=0.05)
    # A copy's lift is scaled with it.
    assert np.allclose(copies[:, 1, 3], 3 + 0.5 * scales)


@pytest.mark.parametrize("up", [UP, (0, 0, -2.5), (1, 2, 3), (0, 1e-200, 1e-200), (1e300, 0, -1e300)])
def test_turned_copies_stay_upright_and_face_all_ways(up):
    copies = Scatter("ground", 500, 1).matrices(np.eye(4), SQUARE, FACES, up)
    axis = np.array(up) / np.max(np.abs(up))
    axis /= np.linalg.norm(axis)
    assert np.allclose(copies[:, :3, :3] @ axis, axis)
    level = np.cross(axis, [0.3, 0.2, 0.9])
    level /= np.linalg.norm(level)
    cosines = (copies[:, :3, :3] @ level) @ level
    assert (np.histogram(cosines, bins=4, range=(-1, 1))[0] > 50).all()


def test_there_must_be_an_up_direction():
    with pytest.raises(SceneError, match="up must not be zero"):
        Scatter("ground", 3).matrices(np.eye(4), SQUARE, FACES, (0, 0, 0))


@pytest.mark.parametrize("turn", [True, False])
def test_aligned_copies_point_along_the_normals(turn):
    ball = make_shape("icosphere", triangles=5120)
    scatter = Scatter("ball", 2000, 5, align="normal", turn=turn)
    copies = scatter.matrices(np.eye(4), ball.vertices, ball.faces, UP)
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
    assert np.allclose(linear @ UP, [0, -1, 0], atol=1e-2)
    normal = np.cross(down[2] - down[0], down[1] - down[0])
    assert np.allclose(linear @ UP, normal / np.linalg.norm(normal), atol=1e-9)


@pytest.mark.parametrize("seed", [3])
def test_the_same_seed_gives_the_same_bytes(seed):
    def scatter(count: int, number: int) -> np.ndarray:
        return Scatter("g", count, number, (0.5, 2), "normal").matrices(BASE, SQUARE, FACES, UP)

    assert scatter(100, seed).tobytes() == scatter(100, seed).tobytes() != scatter(100, seed + 1).tobytes()
    # More copies keep the first ones.
    assert scatter(1000, seed)[:100].tobytes() == scatter(100, seed).tobytes()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Grid((10**6, 10**6, 10**6), (1, 1, 1)), "1,000,000,000,000,000,000 copies are too many"),
        (lambda: Scatter("g", MAX_COPIES + 1), "1,000,001 copies are too many: the limit is 1,000,000"),
        (lambda: Scatter("g", 1, scale=(0, 1)), "scale must be above 0, and the smallest before the largest, not 0, 1"),
        (lambda: Scatter("g", 1, scale=(2, 1)), "scale must be above 0"),
        (lambda: Scatter("g", 1, scale=-1.0), "scale must be above 0"),
        (lambda: Scatter("g", 1, align="sideways"), "align must be one of up, normal, not 'sideways'"),
    ],
)
def test_what_cannot_be_repeated_is_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_copies_must_fit_the_free_memory(monkeypatch):
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1e8)
    Scatter("g", 100)
    with pytest.raises(SceneError, match="900,000 copies need about 900 MB of memory, but 100 MB are free"):
        Scatter("g", 900_000)
    with pytest.raises(SceneError, match="1,000,000 copies need"):
        Grid((1000, 1, 1000), (1, 1, 1))

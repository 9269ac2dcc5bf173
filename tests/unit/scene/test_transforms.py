"""Matrices of instances: those that are refused, and those that are not."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError
from clbvh.scene.transforms import check_transform, check_transforms


def linear(rows):
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return matrix


def rotation(seed):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


TURN = rotation(1)

REGULAR = {
    "identity": np.eye(4),
    "mirror": np.diag([-1.0, 1, 1, 1]),
    "shear": linear([[1, 3, 0], [0, 1, 0], [0, 0, 1]]),
    "tiny": np.diag([1e-30, 1e-30, 1e-30, 1]),
    "huge": np.diag([1e150, 1e150, 1e150, 1]),
    "smallest": np.diag([5e-324, 5e-324, 5e-324, 1]),
    "flat": np.diag([1, 1, 1e-9, 1]),
    "flat, then turned": linear(TURN @ np.diag([1, 1, 1e-30])),
    "needle, then turned": linear(TURN @ np.diag([1, 1e-9, 1e-9])),
    "turned, then flat": linear(np.diag([1, 1, 1e-30]) @ TURN),
    "turned, flat, turned back": linear(TURN @ np.diag([1, 1, 1e-9]) @ TURN.T),
    "far away": np.array([[0, -2, 0, 1e7], [2, 0, 0, -1e300], [0, 0, 2, 0], [0, 0, 0, 1]]),
    "moved": np.array([[0, -2, 1, 10], [2, 0, 0, -4], [0, 0, 3, 7], [0, 0, 0, 1]], np.float64),
}
SINGULAR = {
    "nothing": linear(np.zeros((3, 3))),
    "a zero row": np.diag([1.0, 0, 1, 1]),
    "a zero column": linear([[0, 1, 2], [0, 2, 1], [0, 1, 1]]),
    "two equal rows": linear([[1, 2, 3], [1, 2, 3], [0, 1, 0]]),
    "rank 2": linear([[1, 2, 3], [4, 5, 6], [7, 8, 9]]),
    "rank 1": linear(np.outer([1, 2, 3], [0.1, 0.7, 0.3])),
    "rank 2, tiny": linear(np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]]) * 1e-30),
    "rank 2 but for rounding": linear(TURN @ np.diag([1, 1, 0]) @ TURN.T),
}


@pytest.mark.parametrize("name", REGULAR)
def test_an_invertible_matrix_is_taken_as_it_is(name):
    given = REGULAR[name]
    taken = check_transform(given)
    assert taken.dtype == np.float64
    assert taken.tobytes() == given.astype(np.float64).tobytes()
    assert not np.shares_memory(taken, given)


@pytest.mark.parametrize("name", SINGULAR)
def test_a_singular_matrix_is_refused(name):
    with pytest.raises(SceneError, match="the transform is singular"):
        check_transform(SINGULAR[name])


@pytest.mark.parametrize("seed", range(20))
def test_a_product_of_rank_two_is_refused(seed):
    rng = np.random.default_rng(seed)
    with pytest.raises(SceneError, match="singular"):
        check_transform(linear(rng.normal(size=(3, 2)) @ rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-20, 20)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.eye(3), r"shape \(4, 4\), not \(3, 3\)"),
        (np.zeros((1, 4, 4)), r"shape \(4, 4\), not \(1, 4, 4\)"),
        (5, r"shape \(4, 4\), not \(\)"),
        ([[1, 2], [3]], r"shape \(4, 4\)"),
        ("identity", "must be numbers, not"),
        (np.eye(4, dtype=complex), "must be numbers, not complex128"),
        (np.eye(4, dtype=bool), "must be numbers, not bool"),
        (np.full((4, 4), None), "must be numbers, not object"),
        (np.ma.masked_equal(np.eye(4), 0), "some are masked"),
        (np.diag([1, np.nan, 1, 1]), r"finite, but has nan in row 1, column 1"),
        (np.diag([1, 1, np.inf, 1]), r"finite, but has inf in row 2, column 2"),
        (np.diag([1, 1, 1, 2]), "affine, with the last row 0, 0, 0, 1, not 0, 0, 0, 2"),
        (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 6, 7, 1]]), "not 5, 6, 7, 1: is it transposed"),
    ],
)
def test_something_else_is_refused_by_what_it_is(given, message):
    with pytest.raises(SceneError, match=message) as caught:
        check_transform(given)
    assert "\n" not in str(caught.value)


def test_nothing_is_the_identity():
    assert check_transform(None).tolist() == np.eye(4).tolist()


def test_other_numbers_become_float64():
    assert check_transform(np.eye(4, dtype=np.int8)).dtype == np.float64
    assert check_transform(np.eye(4).tolist()).dtype == np.float64
    assert check_transform(np.eye(4)[::-1][::-1].T).flags.c_contiguous


def test_a_transform_of_a_scene_is_a_matrix():
    transform = clbvh.Transform(scale=2, rotate=(0, 0, 90), translate=(5, 6, 7))
    moved = check_transform(transform) @ [1, 0, 0, 1]
    mesh = clbvh.Mesh.from_arrays([[1, 0, 0], [0, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert moved[:3] == pytest.approx(transform.apply(mesh).vertices[0], abs=1e-14)
    assert moved == pytest.approx([5, 8, 7, 1])


def test_the_first_of_many_faults_is_named():
    matrices = np.tile(np.eye(4), (5, 1, 1))
    matrices[4, 0, 0] = np.nan
    matrices[2] = SINGULAR["rank 2"]
    with pytest.raises(SceneError, match="transform 2 is singular"):
        check_transforms(matrices)
    with pytest.raises(SceneError, match="wheel c is singular"):
        check_transforms(matrices, lambda index: f"wheel {'abcde'[index]}")
    matrices[1, 3, 0] = 1
    with pytest.raises(SceneError, match="transform 1 must be affine"):
        check_transforms(matrices)


def test_many_must_be_an_array_of_matrices():
    assert check_transforms(np.empty((0, 4, 4))).shape == (0, 4, 4)
    for wrong in (np.eye(4), np.zeros((2, 3, 4)), []):
        with pytest.raises(SceneError, match=r"shape \(n, 4, 4\)"):
            check_transforms(wrong)

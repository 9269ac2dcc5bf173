"""Transforms: scaled, rotated about x, y and z, then moved; and the matrices that instances may have."""

import pickle

import numpy as np
import pytest
from trimesh.transformations import quaternion_matrix, translation_matrix

from clbvh import Mesh, SceneError, Transform
from clbvh.scene.transforms import check_transform, check_transforms

TRIANGLE = Mesh.from_arrays([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]], name="corner")
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
RANK_2 = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9.0]])


def linear(rows):
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return matrix


def test_rotations_are_right_handed_and_in_order():
    for rotate, images in (
        ((90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ((0, 90, 0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
        ((0, 0, 90), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ((90, 0, 90), [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),  # about x first, then about z
    ):
        np.testing.assert_allclose(Transform(rotate=rotate).matrix[:3, :3].T, images, atol=1e-15)


def test_the_scale_comes_first_and_the_translation_last():
    transform = Transform(scale=(2, 3, 4), rotate=(0, 0, 90), translate=(10, 20, 30))
    expected = [[10, 22, 30], [7, 20, 30], [10, 20, 34]]
    np.testing.assert_allclose(transform.apply(TRIANGLE).vertices, expected, atol=1e-6)
    moved = np.c_[TRIANGLE.vertices, np.ones(3)] @ np.asarray(transform).T
    np.testing.assert_allclose(moved[:, :3], expected, atol=1e-6)
    assert transform.apply(TRIANGLE).name == "corner"
    assert Transform().apply(TRIANGLE) is TRIANGLE


def test_values_that_are_no_transform_are_refused():
    scales = [{"scale": scale} for scale in (0, (1, 0, 1), (1, 2), (1, 2, float("nan")), "2", None)]
    for values in (*scales, {"rotate": 90}, {"translate": (1, 2)}, {"translate": (1, 2, float("inf"))}):
        with pytest.raises(SceneError, match=f"the transform's {next(iter(values))} must be"):
            Transform(**values)


def test_an_invertible_matrix_is_taken_as_it_is():
    for given in (
        np.diag([-1, 1, 1, 1]),
        linear([[1, 3, 0], [0, 1, 0], [0, 0, 1]]),
        np.diag([5e-324, 5e-324, 5e-324, 1]),
        np.diag([1e150, 1e150, 1e150, 1]),
        linear(TURN @ np.diag([1, 1e-9, 1e-30])),
        linear(np.diag([1, 1, 1e-30]) @ TURN),
        linear(TURN @ np.diag([1, 1, 1e-9]) @ TURN.T),
        np.array([[0, -2, 0, 1e7], [2, 0, 0, -1e300], [0, 0, 2, 0], [0, 0, 0, 1]]),
    ):
        taken = check_transform(given)
        assert taken.tobytes() == given.astype(np.float64).tobytes(), given
        assert not np.shares_memory(taken, given)
    assert check_transform(None).tolist() == check_transform(np.eye(4).tolist()).tolist() == np.eye(4).tolist()


def test_a_singular_matrix_is_refused():
    rng = np.random.default_rng(0)
    thin = [rng.normal(size=(3, 2)) @ rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-20, 20) for _ in range(20)]
    for rows in (
        np.zeros((3, 3)),
        [[0, 1, 2], [0, 2, 1], [0, 1, 1]],
        RANK_2,
        np.outer([1, 2, 3], [0.1, 0.7, 0.3]),
        TURN @ np.diag([1, 1, 0]) @ TURN.T,  # but for rounding
        *thin,
    ):
        with pytest.raises(SceneError, match="the transform is singular"):
            check_transform(linear(rows))


def test_something_else_is_refused_by_what_it_is():
    for given, message in (
        (np.zeros((1, 4, 4)), r"shape \(4, 4\), not \(1, 4, 4\)"),
        ("identity", "must be numbers, not"),
        (np.eye(4, dtype=complex), "must be numbers, not complex128"),
        (np.ma.masked_equal(np.eye(4), 0), "some are masked"),
        (np.diag([1, np.nan, 1, 1]), "finite, but has nan in row 1, column 1"),
        (np.diag([1, 1, 1, 2]), "affine, with the last row 0, 0, 0, 1, not 0, 0, 0, 2"),
        (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 6, 7, 1]]), "not 5, 6, 7, 1: is it transposed"),
    ):
        with pytest.raises(SceneError, match=message):
            check_transform(given)


def test_the_first_fault_of_many_is_named():
    matrices = np.tile(np.eye(4), (5, 1, 1))
    matrices[4, 0, 0] = np.nan
    matrices[2] = linear(RANK_2)
    with pytest.raises(SceneError, match="wheel c is singular"):
        check_transforms(matrices, lambda index: f"wheel {'abcde'[index]}")
    with pytest.raises(SceneError, match=r"shape \(n, 4, 4\)"):
        check_transforms(np.eye(4))


@pytest.mark.parametrize("seed", range(3))
def test_a_quaternion_of_any_length_has_its_real_part_first(seed):
    generator = np.random.default_rng(seed)
    quaternion, place, scale = generator.normal(size=4), generator.normal(size=3), (2, 3, 0.5)
    expected = translation_matrix(place) @ quaternion_matrix(quaternion) @ np.diag([*scale, 1])
    for length in (1.0, -1e200, 1e-200):
        found = Transform.from_quaternion(quaternion * length, place, scale=scale)
        np.testing.assert_allclose(found.matrix, expected, atol=1e-14)


def test_rows_are_taken_as_they_are():
    rows = [[-1, 0.5, 0, 1e7], [0, 1, 0, 2], [0, 0, 3, 3]]
    short, square = Transform(rows=rows), Transform(rows=[*rows, [0, 0, 0, 1]])
    assert short == square == pickle.loads(pickle.dumps(short))
    assert (hash(short), short.matrix.tolist()) == (hash(square), [*rows, [0, 0, 0, 1]])
    assert short.apply(TRIANGLE).vertices.tolist() == [[1e7 - 1, 2, 3], [1e7 + 0.5, 3, 3], [1e7, 2, 6]]


def test_wrong_rows_and_quaternions_are_refused():
    rows = np.eye(4)[:3]
    for make, words in (
        (lambda: Transform(rows=rows, scale=2), "not both"),
        (lambda: Transform(rows=np.eye(3)), r"shape \(4, 4\)"),
        (lambda: Transform(rows=rows * [1, 1, 0, 1]), "singular"),
        (lambda: Transform.from_quaternion((0, 0, 0, 0)), "a quaternion must be four"),
        (lambda: Transform.from_quaternion((1, 0, 0, 0), scale=0), "scale must be"),
    ):
        with pytest.raises(SceneError, match=words):
            make()

"""Transforms scale, then rotate about x, y and z, then translate; the matrix and the moved mesh agree."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, SceneError, Transform

TRIANGLE = Mesh.from_arrays([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]], name="corner")


@pytest.mark.parametrize(
    "values",
    [
        *({"scale": scale} for scale in (0, (1, 0, 1), (1, 2), (1, 2, float("nan")), "2", None)),
        {"rotate": 90},
        {"translate": (1, 2)},
        {"translate": (1, 2, float("inf"))},
    ],
)
def test_one_that_cannot_be_applied_is_refused(values):
    with pytest.raises(SceneError, match="the transform's"):
        Transform(**values)


@pytest.mark.parametrize(
    ("rotate", "images"),
    [
        ((90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ((0, 90, 0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
        ((0, 0, 90), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        # About x first, then about z.
        ((90, 0, 90), [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    ],
)
def test_rotations_are_right_handed_and_in_order(rotate, images):
    np.testing.assert_allclose(Transform(rotate=rotate).matrix[:3, :3].T, images, atol=1e-15)


def test_the_scale_comes_first_and_the_translation_last():
    moved = Transform(scale=(2, 3, 4), rotate=(0, 0, 90), translate=(10, 20, 30)).apply(TRIANGLE)
    np.testing.assert_allclose(moved.vertices, [[10, 22, 30], [7, 20, 30], [10, 20, 34]], atol=1e-6)
    assert moved.name == "corner"


def test_a_mesh_moves_as_its_matrix_says():
    transform = Transform(scale=(0.5, -2, 3), rotate=(10, 20, 30), translate=(1, -2, 3))
    points = np.c_[TRIANGLE.vertices, np.ones(3)] @ np.asarray(transform).T
    np.testing.assert_allclose(transform.apply(TRIANGLE).vertices, points[:, :3], atol=1e-6)


def test_none_keeps_the_mesh():
    assert Transform().apply(TRIANGLE) is TRIANGLE

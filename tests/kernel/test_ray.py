"""What traversal derives from a ray."""

import numpy as np
import pytest

from ..rays import AXES

FLOAT3 = (np.float32, (3,))
OUTPUTS = [FLOAT3, FLOAT3, FLOAT3, FLOAT3, (np.float32, (2,)), np.int32, FLOAT3]

# OpenCL lets a division be 2.5 units in the last place off.
DIVISION = 2.5 * 2.0**-23


@pytest.fixture(scope="module")
def directions():
    generator = np.random.default_rng(3)
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    mixed = generator.normal(size=(500, 3)) * 10.0 ** generator.uniform(-6, 6, (500, 3))
    return np.concatenate((AXES, signs, [[0, 1, -1], [1, 0, 1], [-1, 1, 0]], mixed)).astype(np.float32)


@pytest.fixture(scope="module")
def paths(run_shell, make_rays, directions):
    origins = np.arange(3 * len(directions)).reshape(-1, 3)
    return run_shell("derive_ray", [make_rays(origins, directions, 0.25, 8.5)], OUTPUTS)


def test_the_ray_itself_is_kept(paths, directions):
    origins, kept, _, _, limits, _, _ = paths
    np.testing.assert_array_equal(origins.ravel(), np.arange(origins.size))
    np.testing.assert_array_equal(kept, directions)
    assert (limits == [0.25, 8.5]).all()


def test_the_inverse_of_zero_is_infinite_with_the_sign_of_zero(paths, directions):
    inverse = paths[2].astype(np.float64)
    zero = directions == 0
    assert zero.any()
    np.testing.assert_array_equal(inverse[zero], np.copysign(np.inf, directions[zero]))
    np.testing.assert_allclose(inverse[~zero], 1 / directions[~zero].astype(np.float64), rtol=DIVISION)


def test_the_axis_is_that_of_the_largest_component(paths, directions):
    axis = paths[5]
    size = np.abs(directions)
    np.testing.assert_array_equal(np.take_along_axis(size, axis[:, None], axis=1)[:, 0], size.max(axis=1))
    assert set(axis.tolist()) == {0, 1, 2}


def test_the_axes_turn_in_a_circle(paths):
    axis, turned = paths[5], paths[6]
    expected = np.array([[2, 3, 1], [3, 1, 2], [1, 2, 3]])[axis]
    np.testing.assert_array_equal(turned, expected)


def test_the_shear_lays_the_direction_along_z(paths, directions):
    shear, axis = paths[3].astype(np.float64), paths[5]
    turned = np.stack([np.roll(row, 2 - a) for row, a in zip(directions.astype(np.float64), axis, strict=True)])
    expected = np.stack((turned[:, 0] / turned[:, 2], turned[:, 1] / turned[:, 2], 1 / turned[:, 2]), axis=1)
    np.testing.assert_allclose(shear, expected, rtol=DIVISION, atol=0)
    assert (np.abs(shear[:, :2]) <= 1).all()

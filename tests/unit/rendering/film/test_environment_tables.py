"""Tables of environments: solid angles, shares, and axes."""

import numpy as np
import pytest

from clbvh.rendering.environment_map import find_axes, make_environment_tables, solid_angles


@pytest.mark.parametrize("size", [(1, 1), (4, 2), (1024, 512), (3, 65536)], ids=str)
def test_solid_angles_make_the_sphere(size):
    width, height = size
    angles = solid_angles(width, height)
    assert angles.shape == (height,)
    assert width * angles.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    # The cap around a pole.
    assert width * angles[0] == pytest.approx(4 * np.pi * np.sin(np.pi / (2 * height)) ** 2, rel=1e-12)


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (7, 1), (9, 20)], ids=str)
def test_sums_rise_to_one(size):
    pixels = np.random.default_rng(1).random((*size, 3)).astype(np.float32)
    pixels[size[0] // 2 + 1 :] = 0
    arrays = make_environment_tables(pixels).arrays
    assert arrays["environment_rows"].shape == size[:1]
    assert arrays["environment_columns"].shape == size
    for sums in (arrays["environment_rows"], arrays["environment_columns"]):
        assert sums.dtype == np.float32
        assert (np.diff(sums) >= 0).all()
        assert (sums[..., -1] == 1).all()


def test_a_pixel_lends_light_to_its_neighbours():
    pixels = np.zeros((6, 8, 3), np.float32)
    pixels[2, 0] = 1  # beside the seam
    tables = make_environment_tables(pixels)
    rows = np.diff(tables.arrays["environment_rows"], prepend=0)
    weights = np.array([0, 1, 6, 1, 0, 0]) * solid_angles(8, 6)
    np.testing.assert_allclose(rows, weights / weights.sum(), atol=1e-7)
    columns = np.diff(tables.arrays["environment_columns"], prepend=0)
    np.testing.assert_allclose(columns[2], np.array([6, 1, 0, 0, 0, 0, 0, 1]) / 8, atol=1e-7)


def test_black_maps_have_no_tables():
    tables = make_environment_tables(np.zeros((3, 4, 3), np.float32))
    assert (tables.arrays, tables.width, tables.height) == ({}, 0, 0)


@pytest.mark.parametrize("value", [1e-38, 1e20], ids=str)
def test_light_of_any_strength_has_shares(value):
    tables = make_environment_tables(np.full((2, 4, 3), value, np.float32))
    np.testing.assert_allclose(tables.arrays["environment_rows"], [0.5, 1])
    np.testing.assert_allclose(tables.arrays["environment_columns"], np.tile([0.25, 0.5, 0.75, 1], (2, 1)))


@pytest.mark.parametrize(
    ("up", "front", "right"),
    [
        ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
        ((0, 0, 1), (1, 0, 0), (0, -1, 0)),
        ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
        ((0, -1, 0), (1, 0, 0), (0, 0, -1)),
    ],
)
def test_the_middle_is_along_x(up, front, right):
    found = find_axes(np.array(up, float), 0.0)
    np.testing.assert_allclose(found, [front, right], atol=1e-15)


def test_rotation_is_counter_clockwise_from_above():
    front, right = find_axes(np.array([0.0, 0.0, 1.0]), 90.0)
    np.testing.assert_allclose(front, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-15)

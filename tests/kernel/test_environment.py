"""Directions drawn from an environment: their densities, and the light that they find, by formula."""

import numpy as np
import pytest

import clbvh
from clbvh.rendering.environment_map import find_axes, make_environment_tables, solid_angles
from clbvh.rendering.look_tables import LUMINANCE
from clbvh.structs import LAYOUTS, VIEW

COUNT = 1 << 14
UP = np.array([0.0, 1.0, 0.0])


def make_map(height, width, seed=0):
    generator = np.random.default_rng(seed)
    return (generator.random((height, width, 3)) ** 8).astype(np.float32)


def direction_of(column, row, width, height, up=UP, rotation=0.0):
    """The unit vector of a place in the map, in pixels, by the stated convention."""
    front, right = find_axes(up, rotation)
    longitude, latitude = 2 * np.pi * (np.asarray(column) / width - 0.5), np.pi * np.asarray(row) / height
    level = np.sin(latitude)[..., None]
    around = np.sin(longitude)[..., None] * right + np.cos(longitude)[..., None] * front
    return level * around + np.cos(latitude)[..., None] * up


@pytest.fixture(scope="module")
def draw(run_shell):
    """A function from a map and directions to drawn directions, their light and densities; and the given ones'."""

    def run(pixels, given=None, up=UP, count=COUNT, has_sun=False, **settings):
        view = np.zeros(1, VIEW)
        view["to_sky"], view["to_light"], view["has_sun"] = up, up, has_sun
        tables = make_environment_tables(pixels)
        tables.describe(view, clbvh.View(**settings))
        given = np.tile(up, (count, 1)) if given is None else np.asarray(given)
        numbers = np.arange(len(given), dtype=np.uint32)
        drawn, found = run_shell(
            "draw_environment",
            [numbers, given.astype(np.float32), view.view(np.uint8), *tables.arrays.values()],
            [(np.float32, (8,)), (np.float32, (4,))],
            "draw_environment",
            {"LAYOUT": LAYOUTS["brute"], "HAS_CUTOUTS": 0, "SHADING": 6},
        )
        return drawn.astype(np.float64), found.astype(np.float64)

    return run


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (1, 3), (8, 16), (64, 200)], ids=str)
def test_both_ways_to_the_density_agree(draw, size):
    drawn, _ = draw(make_map(*size))
    np.testing.assert_allclose(np.linalg.norm(drawn[:, :3], axis=1), 1, rtol=1e-6)
    # Rounding puts a few directions at the edges of pixels into the next ones.
    is_close = np.isclose(drawn[:, 6], drawn[:, 7], rtol=1e-4)
    assert is_close.mean() > 0.999


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0.6, 0, -0.8)], ids=str)
def test_the_mean_of_radiance_is_the_integral_of_light(draw, up):
    pixels = make_map(16, 32)
    up = np.array(up, float)
    drawn, _ = draw(pixels, up=up, count=1 << 16)
    _, found = draw(pixels, up=up, given=direction_of(*even_places(32, 16), 32, 16, up))
    rows = even_places(32, 16)[1]
    element = np.sin(np.pi * rows / 16)
    expected = (found[:, :3] * element[:, None]).sum(axis=0) / element.sum() * 4 * np.pi
    np.testing.assert_allclose(drawn[:, 3:6].mean(axis=0), expected, rtol=0.01)


def even_places(width, height, count=16):
    """Places in a map, (columns, rows) in pixels, `count` along each side of a pixel."""
    columns = (np.arange(count * width) + 0.5) / count
    rows = (np.arange(count * height) + 0.5) / count
    columns, rows = np.meshgrid(columns, rows)
    return columns.ravel(), rows.ravel()


def test_density_is_share_over_solid_angle_and_integrates_to_one(draw):
    pixels = make_map(16, 32)
    columns, rows = even_places(32, 16)
    _, found = draw(pixels, given=direction_of(columns, rows, 32, 16))
    element = np.sin(np.pi * rows / 16)
    element *= 4 * np.pi / element.sum()
    assert (found[:, 3] * element).sum() == pytest.approx(1, rel=1e-4)
    # Shares of the light within each pixel.
    pixel = np.floor(rows).astype(int) * 32 + np.floor(columns).astype(int)
    light = np.bincount(pixel, found[:, :3] @ LUMINANCE, 16 * 32) / 16**2 * np.repeat(solid_angles(32, 16), 32)
    shares = np.bincount(pixel, found[:, 3] * element, 16 * 32)
    np.testing.assert_allclose(shares, light / light.sum(), rtol=2e-3)


def test_drawn_directions_have_the_density(draw):
    pixels = make_map(4, 8)
    drawn, _ = draw(pixels, count=1 << 16)
    up = drawn[:, 1]
    row = np.floor(np.arccos(np.clip(up, -1, 1)) / np.pi * 4).astype(int)
    column = np.floor((np.arctan2(drawn[:, 2], drawn[:, 0]) / (2 * np.pi) + 0.5) * 8).astype(int) % 8
    counts = np.bincount(np.minimum(row, 3) * 8 + column, minlength=32)
    tables = make_environment_tables(pixels)
    shares = np.diff(tables.arrays["environment_rows"], prepend=0)[:, None] * np.diff(
        tables.arrays["environment_columns"], prepend=0, axis=1
    )
    expected = shares.ravel() * len(drawn)
    assert ((counts - expected) ** 2 / expected).sum() < 31 + 6 * np.sqrt(62)


def test_a_second_source_gets_half_of_the_samples(draw):
    pixels, given = make_map(4, 8), direction_of(*even_places(8, 4), 8, 4)
    _, alone = draw(pixels, given=given)
    sun = clbvh.Light(direction=(0, 1, 0))
    drawn, both = draw(pixels, given=given, has_sun=True, light=sun)
    np.testing.assert_allclose(both[:, 3], alone[:, 3] / 2, rtol=1e-6)
    assert (drawn[:, 6] == 0).mean() == pytest.approx(0.5, abs=0.03)
    # The automatic light goes out.
    _, without = draw(pixels, given=given, has_sun=True)
    np.testing.assert_array_equal(without, alone)


@pytest.mark.parametrize("rotation", [0, 90, -30, 1000])
def test_light_is_interpolated_between_the_centres_of_pixels(draw, rotation):
    pixels = make_map(8, 16)
    columns, rows = np.meshgrid(np.arange(16), np.arange(8))
    given = direction_of(columns.ravel() + 0.5, rows.ravel() + 0.5, 16, 8, rotation=rotation)
    _, found = draw(pixels, given=given, environment_rotation=rotation, environment_strength=3.0)
    np.testing.assert_allclose(found[:, :3], 3 * pixels.reshape(-1, 3), atol=2e-5)
    # Halfway, also over the seam behind.
    given = direction_of(columns.ravel() + 1.0, rows.ravel() + 0.5, 16, 8, rotation=rotation)
    _, found = draw(pixels, given=given, environment_rotation=rotation)
    means = (pixels + np.roll(pixels, -1, axis=1)) / 2
    np.testing.assert_allclose(found[:, :3], means.reshape(-1, 3), atol=2e-5)


def test_the_middle_is_along_x_and_z_is_to_its_right(draw):
    pixels = np.zeros((2, 4, 3), np.float32)
    pixels[:, 1:3, 0] = 1  # the two columns beside the middle
    pixels[:, 2:, 1] = 1  # the right half
    pixels[0, :, 2] = 1
    given = [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0)]
    _, found = draw(pixels, given=given)
    np.testing.assert_allclose(
        found[:, :3],
        [(1, 0.5, 0.5), (0, 0.5, 0.5), (0.5, 1, 0.5), (0.5, 0, 0.5), (found[4, 0], 0.5, 1), (found[5, 0], 0.5, 0)],
        atol=1e-6,
    )  # fmt: skip


def test_a_single_bright_pixel_at_a_pole_is_found(draw):
    pixels = np.zeros((512, 1024, 3), np.float32)
    pixels[0, 3] = 1e20
    drawn, _ = draw(pixels, count=4096)
    assert np.isfinite(drawn).all()
    assert (drawn[:, 1] > np.cos(3 * np.pi / 512)).all()
    # The integral of the light, 1 to the row's centre and then falling to 0 over a row, times the angle to the pole.
    expected = 1e20 * (13 / 24) * 2 * solid_angles(1024, 512)[0]
    np.testing.assert_allclose(drawn[:, 3:6].mean(axis=0), expected, rtol=0.05)


def test_light_of_the_smallest_numbers_is_drawn(draw):
    drawn, _ = draw(np.full((4, 8, 3), 1e-30, np.float32), count=4096)
    np.testing.assert_allclose(drawn[:, 3:6].mean(axis=0), 4e-30 * np.pi, rtol=0.02)

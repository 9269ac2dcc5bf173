"""Warps by their formulas: ranges, moments, and cells that keep their areas."""

import numpy as np
import pytest

FLOAT2, FLOAT3 = (np.float32, (2,)), (np.float32, (3,))
ROWS = 1024


@pytest.fixture(scope="module")
def warp(run_shell):
    """A function from samples, (n, 2), and the widths of cones to disks, tents, hemispheres, cones and spheres."""

    def run(samples, width=0.5):
        samples = np.ascontiguousarray(samples, np.float32)
        widths = np.full(len(samples), width, np.float32)
        outputs = [FLOAT2, FLOAT2, FLOAT3, FLOAT3, FLOAT3]
        results = run_shell("warp_samples", [samples, widths], outputs, "sampling_shells", {})
        return [result.astype(np.float64) for result in results]

    return run


@pytest.fixture(scope="module")
def grid():
    """The centres of the cells of a square grid: means over it are integrals."""
    centres = (np.arange(ROWS) + 0.5) / ROWS
    return np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)


# The largest difference of a mean over the grid from the integral: roots are steep at an edge of the square.
MOMENT = {"rtol": 0, "atol": 3e-5}


def test_the_disk_is_even(warp, grid):
    disk = warp(grid)[0]
    squared = (disk**2).sum(axis=1)
    assert squared.max() <= 1
    np.testing.assert_allclose(disk.mean(axis=0), 0, **MOMENT)
    np.testing.assert_allclose((disk**2).mean(axis=0), 1 / 4, **MOMENT)
    np.testing.assert_allclose((disk[:, 0] * disk[:, 1]).mean(), 0, **MOMENT)
    np.testing.assert_allclose((squared**2).mean(), 1 / 3, **MOMENT)
    # Sectors have their shares.
    sector = np.floor((np.arctan2(disk[:, 1], disk[:, 0]) / (2 * np.pi) % 1) * 8).astype(int)
    np.testing.assert_allclose(np.bincount(sector) / len(disk), 1 / 8, rtol=2e-3)


def test_neighbours_stay_neighbours_on_the_disk(warp, grid):
    disk = warp(grid)[0].reshape(ROWS, ROWS, 2)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(disk, axis=axis), axis=-1)
        assert step.max() < 3.2 / ROWS


def test_the_hemisphere_is_weighted_by_the_cosine(warp, grid):
    hemisphere = warp(grid)[2]
    np.testing.assert_allclose((hemisphere**2).sum(axis=1), 1, rtol=0, atol=5e-7)
    z = hemisphere[:, 2]
    assert z.min() > 0
    # The density z / pi has the means 2/3 of z, 1/2 of z^2 and 2/5 of z^3.
    np.testing.assert_allclose([z.mean(), (z**2).mean(), (z**3).mean()], [2 / 3, 1 / 2, 2 / 5], **MOMENT)
    np.testing.assert_allclose(hemisphere[:, :2].mean(axis=0), 0, **MOMENT)
    np.testing.assert_allclose((hemisphere[:, :2] ** 2).mean(axis=0), 1 / 4, **MOMENT)


def test_the_sphere_is_even(warp, grid):
    sphere = warp(grid)[4]
    np.testing.assert_allclose((sphere**2).sum(axis=1), 1, rtol=0, atol=1e-6)
    np.testing.assert_allclose(sphere.mean(axis=0), 0, **MOMENT)
    np.testing.assert_allclose(sphere.T @ sphere / len(sphere), np.eye(3) / 3, **MOMENT)
    np.testing.assert_allclose((sphere**4).mean(axis=0), 1 / 5, **MOMENT)


@pytest.mark.parametrize("width", [1e-5, 0.5, 1, 2])
def test_the_cone_is_even(warp, grid, width):
    cone = warp(grid, width)[3]
    width = float(np.float32(width))
    np.testing.assert_allclose((cone**2).sum(axis=1), 1, rtol=0, atol=1e-6)
    depth = 1 - cone[:, 2]
    assert depth.max() <= width + 1e-7
    # z is even from 1 - width to 1.
    np.testing.assert_allclose(depth.mean(), width / 2, rtol=0, atol=1e-7)
    np.testing.assert_allclose(cone[:, :2].mean(axis=0), 0, rtol=0, atol=1e-6 * np.sqrt(width))
    # The mean of x^2 + y^2 = depth (2 - depth).
    of_both = (cone[:, :2] ** 2).mean(axis=0)
    np.testing.assert_allclose(of_both, (width - width**2 / 3) / 2, rtol=2e-6)


def test_the_tent_has_its_density(warp, grid):
    tent = warp(grid)[1]
    assert np.abs(tent).max() <= 1
    np.testing.assert_allclose(tent.mean(axis=0), 0, **MOMENT)
    np.testing.assert_allclose((tent**2).mean(axis=0), 1 / 6, **MOMENT)
    np.testing.assert_allclose((tent**4).mean(axis=0), 1 / 15, **MOMENT)
    np.testing.assert_allclose((tent[:, 0] * tent[:, 1]).mean(), 0, **MOMENT)


def test_corners_of_the_square(warp):
    last = np.nextafter(np.float32(1), np.float32(0))
    corners = np.array([[0, 0], [0, last], [last, 0], [last, last], [0.5, 0.5], [0.5, 0], [0, 0.5]], np.float32)
    disk, tent, hemisphere, cone, sphere = warp(corners)
    for result in (disk, tent, hemisphere, cone, sphere):
        assert np.isfinite(result).all()
    np.testing.assert_array_equal(disk[4], 0)
    np.testing.assert_array_equal(hemisphere[4], [0, 0, 1])
    np.testing.assert_allclose(disk[0], -np.sqrt([0.5, 0.5]), atol=1e-6)
    np.testing.assert_array_equal(disk[5:], [[0, -1], [-1, 0]])
    assert (hemisphere[:, 2] >= 0).all()

"""Samples of pixels: those of neighbours are evenly spread together, and the pattern begins at the centre."""

import numpy as np
import pytest

FLOAT2 = (np.float32, (2,))
SIDE = 8


def draw(run_shell, columns, rows, samples, seed=0):
    begins = np.stack(np.broadcast_arrays(columns, rows, samples, seed), axis=-1).reshape(-1, 4).astype(np.uint32)
    return run_shell("draw_screen_samples", [begins], [FLOAT2, FLOAT2], "look_shells")


def count_in_cells(points, columns, rows):
    cells = np.floor(points.astype(np.float64) * (columns, rows)).astype(int)
    return np.bincount(cells[:, 0] * rows + cells[:, 1], minlength=columns * rows)


@pytest.mark.parametrize("seed", [0, 5])
@pytest.mark.parametrize("corner", [(0, 0), (SIDE, 3 * SIDE), (16384 - SIDE, 0)])
def test_the_pixels_of_a_square_share_out_the_points(run_shell, corner, seed):
    columns, rows, samples = np.meshgrid(
        corner[0] + np.arange(SIDE), corner[1] + np.arange(SIDE), np.arange(8), indexing="ij"
    )
    points, _ = draw(run_shell, columns, rows, samples, seed)
    # 512 points, one in each cell of a grid of 16 x 32, and of one of 32 x 16.
    assert (count_in_cells(points, 16, 32) == 1).all()
    assert (count_in_cells(points, 32, 16) == 1).all()


@pytest.mark.parametrize("pixel", [(0, 0), (5, 9)])
def test_the_samples_of_a_pixel_are_evenly_spread(run_shell, pixel):
    for begin, columns, rows in ((0, 2, 2), (4, 2, 2), (0, 2, 4), (8, 4, 2), (16, 4, 2)):
        points, _ = draw(run_shell, *pixel, np.arange(begin, begin + columns * rows))
        assert (count_in_cells(points, columns, rows) == 1).all()


def test_further_samples_are_other_points(run_shell):
    points, _ = draw(run_shell, 3, 3, np.arange(64))
    assert len(np.unique(points, axis=0)) == 64


def test_the_pattern_begins_at_the_centre_and_is_evenly_spread(run_shell):
    _, pattern = draw(run_shell, 0, 0, np.arange(4096))
    assert (pattern[0] == 0.5).all()
    golden = np.array([0.7548776662466927, 0.5698402909980532])
    expected = (0.5 + np.arange(4096)[:, None] * golden) % 1
    distance = np.abs(pattern - expected)
    assert np.minimum(distance, 1 - distance).max() < 2e-6
    counts = count_in_cells(pattern, 16, 16)
    assert counts.min() >= 13
    assert counts.max() <= 19

"""Rows are found in what is a picture, and in nothing else."""

import numpy as np
import pytest

from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.coherence import find_row_length

SIZES = [(1920, 1080), (640, 480), (64, 64), (1155, 866), (33, 40)]


def row_length(origins, directions):
    return find_row_length(read_rays(origins.reshape(-1, 3), directions.reshape(-1, 3), 0.0, np.inf)[0])


def picture(width, height):
    mesh = make_shape("icosphere", triangles=80)
    return frame_mesh(mesh, aspect=width / height).rays(width, height)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_picture(width, height, dtype):
    assert row_length(*(rays.astype(dtype) for rays in picture(width, height))) == width


def test_a_jittered_picture_with_several_samples():
    origins, directions = picture(320, 200)
    jitter = np.random.default_rng(1).uniform(-0.5, 0.5, directions.shape) * np.abs(directions[0, 1] - directions[0, 0])
    assert row_length(origins, directions + jitter) == 320
    assert row_length(np.repeat(origins, 4, axis=1), np.repeat(directions, 4, axis=1)) == 4 * 320


def test_a_picture_by_columns():
    origins, directions = picture(320, 200)
    assert row_length(origins.swapaxes(0, 1), directions.swapaxes(0, 1)) == 200


def test_a_picture_cut_off_in_a_row():
    origins, directions = (rays.reshape(-1, 3)[: 320 * 150 + 77] for rays in picture(320, 200))
    assert row_length(origins, directions) == 320


def test_parallel_rays_of_a_grid():
    x, y = np.meshgrid(np.linspace(0, 1, 300), np.linspace(0, 1, 300))
    origins = np.stack((x, y, np.full(x.shape, 5.0)), axis=-1)
    assert row_length(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)) == 300


def test_a_scan_all_around_has_rows_without_ends():
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 720, endpoint=False), np.linspace(-1.55, 1.55, 360))
    directions = np.stack((np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)), axis=-1)
    assert row_length(np.zeros_like(directions), directions) == 720


def test_no_picture():
    generator = np.random.default_rng(2)
    origins, directions = (rays.reshape(-1, 3) for rays in picture(320, 200))
    order = generator.permutation(len(origins))
    assert row_length(origins[order], directions[order]) is None
    # A single row, rays that are all the same, and the pixels of a disc: no two rows of it are equally long.
    assert row_length(origins[:320], directions[:320]) is None
    assert row_length(np.zeros((5000, 3)), np.ones((5000, 3))) is None
    x, y = np.meshgrid(np.linspace(-1, 1, 320), np.linspace(-1, 1, 200))
    inside = (x**2 + y**2 < 1).reshape(-1)
    assert row_length(origins[inside], directions[inside]) is None


@pytest.mark.parametrize("count", [0, 1, 31, 512, 5000])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_values_that_are_no_rays(count, value):
    assert row_length(np.full((count, 3), value), np.full((count, 3), value)) is None

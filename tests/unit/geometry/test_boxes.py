"""The hand-written row operations, each through a small compiled function."""

from __future__ import annotations

import numpy as np
from numba import njit

from clbvh.geometry import boxes
from clbvh.structs import BOX_LANES


@njit
def unite(into, into_row, source, row):
    boxes.store_box(into, into_row, boxes.unite(boxes.load_box(source, row), boxes.load_box(into, into_row)))


@njit
def measure(rows, row):
    box = boxes.load_box(rows, row)
    return boxes.half_area(box), [boxes.lane_of(box, lane) for lane in range(BOX_LANES)]


def random_rows(seed, count=6):
    return np.random.default_rng(seed).normal(size=(count, BOX_LANES)).astype(np.float32)


def test_unite_takes_the_minimum_lane_by_lane_and_ignores_what_is_no_number():
    rows, target = random_rows(3), random_rows(4)
    rows[4, 3], target[1] = np.nan, np.inf
    expected = target.copy()
    expected[2], expected[1] = np.fmin(target[2], rows[4]), rows[5]
    unite(target, 2, rows, 4)
    unite(target, 1, rows, 5)
    assert target.tobytes() == expected.tobytes()


def test_areas_are_in_float64_and_lanes_are_counted_from_the_minimum():
    box = np.array([[0, 0, 0, 5, -1e20, -2e20, -3e20, 6]], np.float32)
    x, y, z = (np.float64(np.float32(size)) for size in (1e20, 2e20, 3e20))
    assert measure(box, 0) == (x * y + y * z + z * x, box[0].tolist())
    assert measure(box * np.float32(0), 0)[0] == 0

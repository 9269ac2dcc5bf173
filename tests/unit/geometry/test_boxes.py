"""The hand-written row operations, each through a small compiled function."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from clbvh.geometry import boxes
from clbvh.structs import BOX_LANES, BOX_TALLY, NODE
from clbvh.support.loop_functions import prefetch


@njit
def copy(into, into_row, source, row):
    boxes.store_box(into, into_row, boxes.load_box(source, row))


@njit
def unite(into, into_row, source, row):
    boxes.store_box(into, into_row, boxes.unite(boxes.load_box(source, row), boxes.load_box(into, into_row)))


@njit
def unite_centroid(into, into_row, source, row):
    centroid = boxes.centroid_of(boxes.load_box(source, row))
    boxes.store_box(into, into_row, boxes.unite(centroid, boxes.load_box(into, into_row)))


def random_rows(seed, count=5):
    return np.random.default_rng(seed).normal(size=(count, BOX_LANES)).astype(np.float32)


def test_copy_moves_one_row_and_no_other():
    rows, target = random_rows(1), random_rows(2)
    expected = target.copy()
    expected[3] = rows[1]
    copy(target, 3, rows, 1)
    assert target.tobytes() == expected.tobytes()


@pytest.mark.parametrize("pattern", [1, 2**30, 0x7FA00001, -1, -(2**31)])
def test_copy_keeps_every_bit_pattern(pattern):
    rows, target = np.zeros((2, BOX_LANES), np.float32), np.zeros((2, BOX_LANES), np.float32)
    rows.view(np.int32)[1] = pattern
    copy(target, 0, rows, 1)
    assert (target.view(np.int32)[0] == pattern).all()


def test_unite_takes_the_minimum_lane_by_lane():
    rows, target = random_rows(3), random_rows(4)
    expected = target.copy()
    expected[2] = np.minimum(target[2], rows[4])
    unite(target, 2, rows, 4)
    assert target.tobytes() == expected.tobytes()


def test_unite_with_an_empty_box_gives_the_other():
    rows = random_rows(5, 1)
    empty = np.full((1, BOX_LANES), np.inf, np.float32)
    unite(empty, 0, rows, 0)
    assert empty.tobytes() == rows.tobytes()
    unite(rows, 0, np.full((1, BOX_LANES), np.inf, np.float32), 0)
    assert rows.tobytes() == empty.tobytes()


def test_unite_ignores_a_lane_that_is_not_a_number():
    rows, target = random_rows(6, 1), random_rows(7, 1)
    rows[0, 3] = np.nan
    expected = np.fmin(target, rows)
    unite(target, 0, rows, 0)
    assert target.tobytes() == expected.tobytes()


def test_centroid_is_the_sum_of_both_ends_and_its_negative():
    rows = np.zeros((2, BOX_LANES), np.float32)
    rows[1] = [1, 2, 3, 0, -5, -7, -11, 0]  # a box from (1, 2, 3) to (5, 7, 11)
    target = np.full((1, BOX_LANES), np.inf, np.float32)
    unite_centroid(target, 0, rows, 1)
    assert target[0, :3].tolist() == [6, 9, 14]
    assert target[0, 4:7].tolist() == [-6, -9, -14]


def test_centroids_are_bounded_from_both_sides():
    rows = random_rows(8, 20)
    rows[:, 4:7] = -np.maximum(rows[:, :3], -rows[:, 4:7])
    target = np.full((1, BOX_LANES), np.inf, np.float32)
    for row in range(len(rows)):
        unite_centroid(target, 0, rows, row)
    centroids = rows[:, :3] - rows[:, 4:7]
    assert target[0, :3].tolist() == centroids.min(axis=0).tolist()
    assert target[0, 4:7].tolist() == (-centroids.max(axis=0)).tolist()


def test_rows_of_a_part_of_an_array_are_counted_from_its_beginning():
    whole = random_rows(9, 6)
    expected = whole.copy()
    expected[5] = whole[3]
    copy(whole[2:], 3, whole[2:], 1)
    assert whole.tobytes() == expected.tobytes()


@njit
def load_points(points, rows):
    for point in range(len(points)):
        boxes.store_box(rows, point, boxes.load_point(points, point))


def test_a_point_is_a_box_without_extent_and_without_negative_zeros():
    points = np.random.default_rng(13).normal(size=(4, 3)).astype(np.float32)
    points[1] = -0.0
    points[2] = 0.0
    rows = np.full((4, BOX_LANES), np.nan, np.float32)
    load_points(points, rows)
    assert rows[:, :3].tolist() == points.tolist()
    assert (rows[:, 4:7] == -points).all()
    assert not np.signbit(rows[1:3]).any()


@njit
def make_node(rows, row, first, count):
    boxes.store_box(rows, row, boxes.as_node(boxes.load_box(rows, row), first, count))


@pytest.mark.parametrize(("first", "count"), [(0, 0), (7, 4), (2**31 - 1, 255)])
def test_a_node_has_its_maximum_as_it_is(first, count):
    rows = random_rows(14)
    rows[2, 4:7] = [0.0, -0.0, 3.0]
    box = rows[2].copy()
    make_node(rows, 2, first, count)
    node = rows[2:3].view(NODE)[0, 0]
    assert node["aabb_min"].tolist() == box[:3].tolist()
    assert node["aabb_max"].tolist() == [0.0, 0.0, -3.0]
    assert not np.signbit(node["aabb_max"][:2]).any()
    assert (node["first"], node["count"]) == (first, count)


@njit
def make_box(rows, row):
    boxes.store_box(rows, row, boxes.box_of_node(boxes.load_box(rows, row)))


def test_the_box_of_a_node_is_what_the_node_was_made_of():
    rows = random_rows(15)
    expected = rows[3].copy()
    make_node(rows, 3, 1, 2)
    make_box(rows, 3)
    assert rows[3, [0, 1, 2, 4, 5, 6]].tolist() == expected[[0, 1, 2, 4, 5, 6]].tolist()


@njit
def add(rows, row, source):
    for added in range(len(source)):
        boxes.add_to_box(rows, row, boxes.load_box(source, added))
    return boxes.tally_of(boxes.load_box(rows, row))


def test_boxes_are_united_and_counted():
    source, target = random_rows(11, 300), np.full((2, BOX_LANES), np.inf, np.float32)
    target.view(np.int32)[:, BOX_TALLY] = 7
    assert add(target, 1, source) == 307
    assert target[1, :BOX_TALLY].tolist() == source[:, :BOX_TALLY].min(axis=0).tolist()
    assert (target[0, :BOX_TALLY] == np.inf).all()


@njit
def prefetch_all(rows):
    for number in range(-1000, 2 * rows.size):
        prefetch(rows, number)


def test_asking_for_numbers_changes_none_and_may_pass_both_ends():
    rows = random_rows(12)
    expected = rows.copy()
    prefetch_all(rows)
    assert rows.tobytes() == expected.tobytes()


@njit
def half_area(rows, row):
    return boxes.half_area(boxes.load_box(rows, row))


def test_half_area_is_in_float64():
    box = np.array([[0, 0, 0, 0, -1e20, -2e20, -3e20, 0]], np.float32)
    x, y, z = (np.float64(np.float32(size)) for size in (1e20, 2e20, 3e20))
    assert half_area(box, 0) == x * y + y * z + z * x
    assert half_area(box * np.float32(0), 0) == 0


@njit
def lanes(rows, row):
    box = boxes.load_box(rows, row)
    return [boxes.lane_of(box, lane) for lane in range(BOX_LANES)]


def test_lanes_are_counted_from_the_minimum():
    rows = random_rows(10)
    assert lanes(rows, 2) == rows[2].tolist()


@njit
def bins(rows, row, lower, scale):
    return boxes.bins_of(boxes.load_box(rows, row), boxes.load_box(lower, 0), boxes.load_box(scale, 0))


def test_bins_are_counted_from_the_lower_bound_on_each_axis():
    rows = np.array([[1, 2, 3, 0, -5, -7, -11, 0]], np.float32)  # doubled centroid (6, 9, 14)
    lower = np.array([[5, 9, 4, 0, 0, 0, 0, 0]], np.float32)
    scale = np.array([[3, 100, 0.25, 0, 0, 0, 0, 0]], np.float32)
    assert bins(rows, 0, lower, scale) == (3, 0, 2)

"""The hand-written row operations, each through a small compiled function."""

from __future__ import annotations

import numpy as np
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


@njit
def load_points(points, rows):
    for point in range(len(points)):
        boxes.store_box(rows, point, boxes.load_point(points, point))


@njit
def make_node(rows, row, first, count):
    boxes.store_box(rows, row, boxes.as_node(boxes.load_box(rows, row), first, count))


@njit
def make_box(rows, row):
    boxes.store_box(rows, row, boxes.box_of_node(boxes.load_box(rows, row)))


@njit
def add(rows, row, source):
    for added in range(len(source)):
        boxes.add_to_box(rows, row, boxes.load_box(source, added))
    return boxes.tally_of(boxes.load_box(rows, row))


@njit
def prefetch_all(rows):
    for number in range(-1000, 2 * rows.size):
        prefetch(rows, number)


@njit
def measure(rows, row):
    box = boxes.load_box(rows, row)
    return boxes.half_area(box), [boxes.lane_of(box, lane) for lane in range(BOX_LANES)]


@njit
def bins(rows, row, lower, scale):
    return boxes.bins_of(boxes.load_box(rows, row), boxes.load_box(lower, 0), boxes.load_box(scale, 0))


def random_rows(seed, count=6):
    return np.random.default_rng(seed).normal(size=(count, BOX_LANES)).astype(np.float32)


def test_copy_moves_one_row_of_any_bits_and_no_other():
    rows, target = random_rows(1), random_rows(2)
    for pattern in (1, 2**30, 0x7FA00001, -1, -(2**31)):
        rows.view(np.int32)[1] = pattern
        expected = target.copy()
        expected[5] = rows[1]
        copy(target[2:], 3, rows, 1)  # rows of a part of an array are counted from its beginning
        assert target.tobytes() == expected.tobytes()
    prefetch_all(target)
    assert target.tobytes() == expected.tobytes()


def test_unite_takes_the_minimum_lane_by_lane_and_ignores_what_is_no_number():
    rows, target = random_rows(3), random_rows(4)
    rows[4, 3], target[1] = np.nan, np.inf
    expected = target.copy()
    expected[2], expected[1] = np.fmin(target[2], rows[4]), rows[5]
    unite(target, 2, rows, 4)
    unite(target, 1, rows, 5)
    assert target.tobytes() == expected.tobytes()


def test_centroids_are_the_sums_of_both_ends_and_are_bounded_from_both_sides():
    rows = random_rows(8, 20)
    rows[:, 4:7] = -np.maximum(rows[:, :3], -rows[:, 4:7])
    target = np.full((1, BOX_LANES), np.inf, np.float32)
    for row in range(len(rows)):
        unite_centroid(target, 0, rows, row)
    centroids = rows[:, :3] - rows[:, 4:7]
    assert target[0, :3].tolist() == centroids.min(axis=0).tolist()
    assert target[0, 4:7].tolist() == (-centroids.max(axis=0)).tolist()


def test_a_point_is_a_box_without_extent_and_without_negative_zeros():
    points = np.random.default_rng(13).normal(size=(4, 3)).astype(np.float32)
    points[1:3] = [[-0.0] * 3, [0.0] * 3]
    rows = np.full((4, BOX_LANES), np.nan, np.float32)
    load_points(points, rows)
    assert rows[:, :3].tolist() == points.tolist()
    assert (rows[:, 4:7] == -points).all()
    assert not np.signbit(rows[1:3]).any()


def test_a_node_has_its_maximum_as_it_is_and_becomes_the_same_box():
    for first, count in ((0, 0), (7, 4), (2**31 - 1, 255)):
        rows = random_rows(14)
        rows[2, 4:7] = [0.0, -0.0, 3.0]
        box = rows[2].copy()
        make_node(rows, 2, first, count)
        node = rows[2:3].view(NODE)[0, 0]
        assert (node["aabb_min"].tolist(), node["aabb_max"].tolist()) == (box[:3].tolist(), [0.0, 0.0, -3.0])
        assert not np.signbit(node["aabb_max"][:2]).any()
        assert (node["first"], node["count"]) == (first, count)
        make_box(rows, 2)
        assert rows[2, [0, 1, 2, 4, 5, 6]].tolist() == box[[0, 1, 2, 4, 5, 6]].tolist()


def test_boxes_are_united_and_counted():
    source, target = random_rows(11, 300), np.full((2, BOX_LANES), np.inf, np.float32)
    target.view(np.int32)[:, BOX_TALLY] = 7
    assert add(target, 1, source) == 307
    assert target[1, :BOX_TALLY].tolist() == source[:, :BOX_TALLY].min(axis=0).tolist()
    assert (target[0, :BOX_TALLY] == np.inf).all()


def test_areas_are_in_float64_and_lanes_and_bins_are_counted_from_the_minimum():
    box = np.array([[0, 0, 0, 5, -1e20, -2e20, -3e20, 6]], np.float32)
    x, y, z = (np.float64(np.float32(size)) for size in (1e20, 2e20, 3e20))
    assert measure(box, 0) == (x * y + y * z + z * x, box[0].tolist())
    assert measure(box * np.float32(0), 0)[0] == 0
    rows = np.array([[1, 2, 3, 0, -5, -7, -11, 0]], np.float32)  # doubled centroid (6, 9, 14)
    lower = np.array([[5, 9, 4, 0, 0, 0, 0, 0]], np.float32)
    scale = np.array([[3, 100, 0.25, 0, 0, 0, 0, 0]], np.float32)
    assert bins(rows, 0, lower, scale) == (3, 0, 2)

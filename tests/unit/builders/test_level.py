"""Nodes of a level, slice by slice, against the same nodes one by one."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import build
from clbvh.builders.options import MAX_DEPTH
from clbvh.builders.sah import top
from clbvh.builders.sah.split import Slice, bin_count_for, fill_bins, find_split, make_bins, partition, unite_sides
from clbvh.builders.sah.top import (
    LEFT_COUNT,
    bin_slices,
    choose_splits,
    make_level,
    partition_slices,
    slice_begin,
    unite_bins,
)
from clbvh.structs import BOX_LANES, BOX_TALLY

from ...soup import make_soup
from .prim_refs import make_prim_refs

COUNT, BINS = 300, 8
UNTOUCHED = -7.0


def make_one_level(slice_count, *, depth=0):
    """Return buffers, and a level of three nodes: of all primitives' bounds, of equal primitives, and one more."""
    prim_refs, bounds = make_prim_refs(make_soup(COUNT, seed=1, grid=20, copies=0.2))
    prim_refs[1] = UNTOUCHED
    prim_refs[0, 200:240] = prim_refs[0, 200]
    ranges = np.array([(0, 200, 0), (200, 240, 0), (240, COUNT, 0)])
    point = prim_refs[0, 200] + np.roll(-prim_refs[0, 200], 4)
    flat = np.stack([prim_refs[0, 200], np.concatenate([point[:4], -point[:4]])])
    level = make_level(ranges, np.stack([bounds, flat, bounds]), slice_count, BINS)
    for number in range(slice_count):
        bin_slices(prim_refs, level, number, BINS)
    choose_splits(level, depth, BINS)
    return prim_refs, level


@pytest.mark.parametrize("slice_count", [1, 2, 7, 64])
def test_splits_and_partitions_are_those_of_single_nodes(slice_count):
    prim_refs, level = make_one_level(slice_count)
    for number in range(slice_count):
        partition_slices(prim_refs, level, number)
    assert level.splits[1, LEFT_COUNT] == 0
    assert (prim_refs[1, 200:240] == UNTOUCHED).all()

    for node in (0, 2):
        begin, end, _ = (int(column) for column in level.ranges[node])
        bins, boxes, centroid_boxes = make_bins(BINS), *np.empty((2, 2, BOX_LANES), np.float32)
        fill_bins(prim_refs[0], begin, end, level.bounds[node], bin_count_for(end - begin, BINS), bins)
        split = find_split(bins, bin_count_for(end - begin, BINS), np.empty(3 * BINS))
        unite_sides(bins, split, boxes)
        target = np.full_like(prim_refs[0], UNTOUCHED)
        part = Slice(begin, end, begin, begin + split.left_count)
        partition(prim_refs[0], target, part, level.bounds[node], split, centroid_boxes)
        assert level.splits[node].tolist() == [split.axis, split.last_left_bin, split.left_count, split.bin_count]
        assert level.boxes[node, :, :3].tobytes() == boxes[:, :3].tobytes()
        assert prim_refs[1, begin:end].tobytes() == target[begin:end].tobytes()
        united = np.minimum.reduce(level.centroid_boxes[node])
        assert united[:, [0, 1, 2, 4, 5, 6]].tobytes() == centroid_boxes[:, [0, 1, 2, 4, 5, 6]].tobytes()


def test_near_the_greatest_depth_nodes_are_halved():
    _, level = make_one_level(2, depth=MAX_DEPTH - 7)
    assert (level.splits[:, LEFT_COUNT] == 0).tolist() == [True, True, False]


@pytest.mark.parametrize("slice_count", [1, 2, 3, 8])
def test_slices_cover_a_node_once(slice_count):
    level = make_level(np.array([(5, 12, 0)]), np.zeros((1, 2, BOX_LANES), np.float32), slice_count, BINS)
    ends = [slice_begin(level, 0, number) for number in range(slice_count + 1)]
    assert (ends[0], ends[-1]) == (5, 12)
    assert ends == sorted(ends)


def test_bins_of_slices_unite_to_minima_and_sums():
    slice_bins = np.random.default_rng(0).normal(size=(3, 6, BOX_LANES)).astype(np.float32)
    slice_bins.view(np.int32)[..., BOX_TALLY] = np.arange(18).reshape(3, 6)
    united = np.empty((6, BOX_LANES), np.float32)
    unite_bins(slice_bins, 6, united)
    assert united[:, :BOX_TALLY].tolist() == slice_bins[..., :BOX_TALLY].min(axis=0).tolist()
    assert united.view(np.int32)[:, BOX_TALLY].tolist() == np.arange(18).reshape(3, 6).sum(axis=0).tolist()


def test_a_level_is_split_some_nodes_at_a_time(monkeypatch):
    mesh = make_soup(3000, seed=2)
    counts = []

    def count_and_make(ranges, *rest):
        counts.append(len(ranges))
        return make_level(ranges, *rest)

    monkeypatch.setattr(top, "make_level", count_and_make)
    whole, node_count = build(mesh, task_threshold=20), sum(counts)
    counts.clear()
    monkeypatch.setattr(top, "_NODES_AT_ONCE", 5)
    assert build(mesh, task_threshold=20).nodes.tobytes() == whole.nodes.tobytes()
    assert (max(counts), sum(counts)) == (5, node_count)

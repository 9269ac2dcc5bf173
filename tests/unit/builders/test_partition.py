"""Records move to their side of a split, in their order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh.build.partition import bound_halves, partition
from clbvh.simd import LANES

from ..soup import make_soup
from .records import bins_by_numpy, boxes_of, make_records

BINS = 8
UNTOUCHED = -7.0


def centroid_bounds_by_numpy(rows):
    lower, upper = boxes_of(rows)
    return (lower + upper).min(axis=0).tolist(), (-(lower + upper).max(axis=0)).tolist()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("last_left", [0, 3, 6])
@pytest.mark.parametrize("slices", [[0, 100], [0, 1, 40, 40, 100]])
def test_records_keep_their_order_on_both_sides(axis, last_left, slices):
    records, bounds = make_records(make_soup(100, seed=1, grid=20, copies=0.2))
    source, target = records[0], np.full((100, LANES), UNTOUCHED, np.float32)
    goes_left = bins_by_numpy(source, bounds[1], BINS)[:, axis] <= last_left

    left, right = 0, int(goes_left.sum())
    assert 0 < right < 100
    parts = []
    for begin, end in itertools.pairwise(slices):
        child_bounds = np.full((2, LANES), UNTOUCHED, np.float32)
        partition(source, begin, end, bounds, 1, BINS, axis, last_left, target, left, right, child_bounds)
        left += int(goes_left[begin:end].sum())
        right += int((~goes_left[begin:end]).sum())
        parts.append(child_bounds)

    assert target.tobytes() == np.concatenate([source[goes_left], source[~goes_left]]).tobytes()
    united = np.minimum.reduce(parts)
    for side, chosen in enumerate((goes_left, ~goes_left)):
        assert (united[side, :3].tolist(), united[side, 4:7].tolist()) == centroid_bounds_by_numpy(source[chosen])


def test_a_slice_writes_only_to_its_own_places():
    records, bounds = make_records(make_soup(60, seed=2))
    target = np.full((200, LANES), UNTOUCHED, np.float32)
    goes_left = bins_by_numpy(records[0], bounds[1], BINS)[20:50, 0] <= 3
    child_bounds = np.empty((2, LANES), np.float32)
    partition(records[0], 20, 50, bounds, 1, BINS, 0, 3, target, 70, 130, child_bounds)
    written = np.flatnonzero((target != UNTOUCHED).any(axis=1))
    assert written.tolist() == [*range(70, 70 + goes_left.sum()), *range(130, 130 + (~goes_left).sum())]


def test_halves_are_bounded_and_nothing_moves():
    records, _ = make_records(make_soup(30, seed=3))
    before = records.tobytes()
    boxes, child_bounds = np.empty((2, LANES), np.float32), np.empty((2, LANES), np.float32)
    bound_halves(records[0], 5, 12, 21, boxes, child_bounds)
    assert records.tobytes() == before
    for side, rows in enumerate((records[0][5:12], records[0][12:21])):
        lower, upper = boxes_of(rows)
        assert boxes[side, :3].tolist() == lower.min(axis=0).tolist()
        assert boxes[side, 4:7].tolist() == (-upper.max(axis=0)).tolist()
        assert (child_bounds[side, :3].tolist(), child_bounds[side, 4:7].tolist()) == centroid_bounds_by_numpy(rows)

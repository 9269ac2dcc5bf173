"""Primitive references move to their side of a split, in their order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh.builders.sah.split import Slice, Split, bound_halves, partition
from clbvh.structs import BOX_LANES

from ...soup import make_soup
from .prim_refs import bins_by_numpy, boxes_of, make_prim_refs

BINS = 8
UNTOUCHED = -7.0


def centroid_bounds_by_numpy(rows):
    lower, upper = boxes_of(rows)
    return (lower + upper).min(axis=0).tolist(), (-(lower + upper).max(axis=0)).tolist()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("last_left", [0, 3, 6])
@pytest.mark.parametrize("slices", [[0, 100], [0, 1, 40, 40, 100]])
def test_references_keep_their_order_on_both_sides(axis, last_left, slices):
    prim_refs, bounds = make_prim_refs(make_soup(100, seed=1, grid=20, copies=0.2))
    source, target = prim_refs[0], np.full((100, BOX_LANES), UNTOUCHED, np.float32)
    goes_left = bins_by_numpy(source, bounds[1], BINS)[:, axis] <= last_left

    left, right = 0, int(goes_left.sum())
    assert 0 < right < 100
    parts = []
    for begin, end in itertools.pairwise(slices):
        child_bounds = np.full((2, BOX_LANES), UNTOUCHED, np.float32)
        split = Split(0.0, axis, last_left, 0, BINS)
        partition(source, target, Slice(begin, end, left, right), bounds, split, child_bounds)
        left += int(goes_left[begin:end].sum())
        right += int((~goes_left[begin:end]).sum())
        parts.append(child_bounds)

    assert target.tobytes() == np.concatenate([source[goes_left], source[~goes_left]]).tobytes()
    united = np.minimum.reduce(parts)
    for side, chosen in enumerate((goes_left, ~goes_left)):
        assert (united[side, :3].tolist(), united[side, 4:7].tolist()) == centroid_bounds_by_numpy(source[chosen])


def test_a_slice_writes_only_to_its_own_slots():
    prim_refs, bounds = make_prim_refs(make_soup(60, seed=2))
    target = np.full((200, BOX_LANES), UNTOUCHED, np.float32)
    goes_left = bins_by_numpy(prim_refs[0], bounds[1], BINS)[20:50, 0] <= 3
    child_bounds = np.empty((2, BOX_LANES), np.float32)
    partition(prim_refs[0], target, Slice(20, 50, 70, 130), bounds, Split(0.0, 0, 3, 0, BINS), child_bounds)
    written = np.flatnonzero((target != UNTOUCHED).any(axis=1))
    assert written.tolist() == [*range(70, 70 + goes_left.sum()), *range(130, 130 + (~goes_left).sum())]


def test_halves_are_bounded_and_nothing_moves():
    prim_refs, _ = make_prim_refs(make_soup(30, seed=3))
    before = prim_refs.tobytes()
    boxes, child_bounds = np.empty((2, BOX_LANES), np.float32), np.empty((2, BOX_LANES), np.float32)
    bound_halves(prim_refs[0], 5, 12, 21, boxes, child_bounds)
    assert prim_refs.tobytes() == before
    for side, rows in enumerate((prim_refs[0][5:12], prim_refs[0][12:21])):
        lower, upper = boxes_of(rows)
        assert boxes[side, :3].tolist() == lower.min(axis=0).tolist()
        assert boxes[side, 4:7].tolist() == (-upper.max(axis=0)).tolist()
        assert (child_bounds[side, :3].tolist(), child_bounds[side, 4:7].tolist()) == centroid_bounds_by_numpy(rows)

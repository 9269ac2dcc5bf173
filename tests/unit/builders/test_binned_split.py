"""Bins and the choice of a split, against a slow oracle in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from clbvh import Mesh
from clbvh.builders.sah.split import Split, bin_count_for, bin_scales, fill_bins, find_split, make_bins, unite_sides
from clbvh.geometry.boxes import lane_of, load_box
from clbvh.structs import BOX_LANES, BOX_TALLY

from ...soup import make_soup
from .prim_refs import bins_by_numpy, boxes_of, make_prim_refs, split_by_numpy

# The lanes of a row that are its box.
BOX = [0, 1, 2, 4, 5, 6]

# Few grid points make many equal centroids, equal costs and empty bins.
SOUPS = {
    "fine": {"count": 300},
    "coarse": {"count": 300, "grid": 3, "size": 2},
    "copies": {"count": 200, "copies": 0.8, "degenerate": 0.3},
    "few": {"count": 3},
    "two places": {"count": 64, "grid": 1, "size": 0},
    "tiny": {"count": 100, "scale": 1e-30},
    "huge": {"count": 100, "scale": 1e30},
}


def fill(prim_refs, bounds, bin_count, begin=0, end=None):
    bins = make_bins(bin_count)
    bins[:] = np.nan
    fill_bins(prim_refs, begin, len(prim_refs) if end is None else end, bounds, bin_count, bins)
    return bins


def counts_of(bins):
    return bins.view(np.int32)[:, BOX_TALLY]


@njit
def scale_of(bounds, row, axis, bin_count):
    return lane_of(bin_scales(load_box(bounds, row), bin_count), axis)


def find(bins, bin_count):
    return find_split(bins, bin_count, np.empty(3 * bin_count, np.float64))


@pytest.mark.parametrize(
    ("prim_count", "bins", "expected"),
    [(1, 16, 4), (16, 16, 4), (20, 16, 5), (63, 16, 15), (64, 16, 16), (10**6, 16, 16), (1, 2, 2), (10**6, 64, 64)],
)
def test_small_ranges_get_fewer_bins(prim_count, bins, expected):
    assert bin_count_for(prim_count, bins) == expected


@pytest.mark.parametrize("bin_count", [2, 4, 16, 64])
@pytest.mark.parametrize("soup", SOUPS)
def test_bins_are_those_of_the_oracle(soup, bin_count):
    prim_refs, bounds = make_prim_refs(make_soup(seed=1, **SOUPS[soup]))
    bins = fill(prim_refs[0], bounds, bin_count)
    expected = bins_by_numpy(prim_refs[0], bounds[1], bin_count)
    assert expected.min() >= 0
    assert expected.max() < bin_count
    for axis in range(3):
        for number in range(bin_count):
            row = axis * bin_count + number
            inside = prim_refs[0][expected[:, axis] == number]
            assert counts_of(bins)[row] == len(inside)
            if len(inside):
                assert bins[row, BOX].tolist() == inside[:, BOX].min(axis=0).tolist()
            else:
                assert (bins[row, BOX] == np.inf).all()


@pytest.mark.parametrize("bin_count", [2, 4, 16])
@pytest.mark.parametrize("soup", SOUPS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_split_is_the_cheapest_and_the_first_of_equals(soup, bin_count, seed):
    prim_refs, bounds = make_prim_refs(make_soup(seed=seed, **SOUPS[soup]))
    found = find(fill(prim_refs[0], bounds, bin_count), bin_count)
    expected = bins_by_numpy(prim_refs[0], bounds[1], bin_count)
    assert found == (*split_by_numpy(prim_refs[0], expected, bin_count), bin_count)


def test_slices_of_a_range_add_up():
    prim_refs, bounds = make_prim_refs(make_soup(100, seed=4))
    whole = fill(prim_refs[0], bounds, 16)
    parts = [fill(prim_refs[0], bounds, 16, begin, end) for begin, end in ((0, 10), (10, 10), (10, 77), (77, 100))]
    assert np.minimum.reduce(parts)[:, BOX].tobytes() == whole[:, BOX].tobytes()
    assert (sum(counts_of(part) for part in parts) == counts_of(whole)).all()


def test_equal_centroids_have_no_split():
    prim_refs, bounds = make_prim_refs(make_soup(10, seed=5, grid=0, size=0))
    assert find(fill(prim_refs[0], bounds, 16), 16)[0] == np.inf


def test_a_flat_axis_is_one_bin_and_the_others_split():
    corners = make_soup(50, seed=6).vertices.copy()
    corners[:, 1] = 7
    prim_refs, bounds = make_prim_refs(Mesh.from_arrays(corners, np.arange(150).reshape(-1, 3)))
    assert scale_of(bounds, 1, 1, 16) == 0
    bins = fill(prim_refs[0], bounds, 16)
    assert counts_of(bins)[16] == 50
    assert find(bins, 16)[1] in (0, 2)


@pytest.mark.parametrize(("extent", "flat"), [(2.0**-110, True), (2.0**-109, False), (1e-45, True), (3e38, False)])
def test_extents_too_small_for_bins_are_flat(extent, flat):
    bounds = np.zeros((2, BOX_LANES), np.float32)
    bounds[1, 4] = -extent
    scale = scale_of(bounds, 1, 0, 64)
    assert np.isfinite(scale)
    assert (scale == 0) == flat


@pytest.mark.parametrize("seed", range(5))
def test_the_upper_end_falls_into_the_last_bin_whatever_the_rounding(seed):
    random = np.random.default_rng(seed)
    for _ in range(200):
        lower, upper = np.sort((random.normal(size=2) * 10.0 ** random.integers(-20, 20)).astype(np.float32))
        prim_refs = np.zeros((2, BOX_LANES), np.float32)
        prim_refs[:, 0] = lower, upper
        prim_refs[:, 4] = -prim_refs[:, 0]
        bounds = np.zeros((2, BOX_LANES), np.float32)
        bounds[1, 0], bounds[1, 4] = 2 * lower, -2 * upper
        for bin_count in (2, 3, 16, 64):
            counts = counts_of(fill(prim_refs, bounds, bin_count))
            assert counts[0] == counts[bin_count - 1] == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("last_left", [0, 7, 14])
def test_the_sides_are_the_union_of_their_bins(axis, last_left):
    prim_refs, bounds = make_prim_refs(make_soup(200, seed=8))
    sides = np.empty((2, BOX_LANES), np.float32)
    unite_sides(fill(prim_refs[0], bounds, 16), Split(0.0, axis, last_left, 0, 16), sides)
    left = bins_by_numpy(prim_refs[0], bounds[1], 16)[:, axis] <= last_left
    for side, chosen in enumerate((left, ~left)):
        lower, upper = boxes_of(prim_refs[0][chosen])
        assert sides[side, :3].tolist() == lower.min(axis=0).tolist()
        assert sides[side, 4:7].tolist() == (-upper.max(axis=0)).tolist()

"""Divisions of a few primitives, against all divisions by brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh.builders.sah.split import MAX_EXHAUSTIVE, count_left, divide, find_exhaustive_split
from clbvh.structs import BOX_LANES

from ...soup import make_soup
from .prim_refs import boxes_of, make_prim_refs


def cost_of(rows):
    lower, upper = boxes_of(rows.astype(np.float64))
    x, y, z = upper.max(axis=0) - lower.min(axis=0)
    return (x * y + y * z + z * x) * len(rows)


def sides(rows, left):
    goes_left = np.array([left >> index & 1 for index in range(len(rows))], bool)
    return rows[goes_left], rows[~goes_left]


@pytest.mark.parametrize("prim_count", range(2, MAX_EXHAUSTIVE + 1))
@pytest.mark.parametrize("grid", [None, 2])
@pytest.mark.parametrize("seed", range(10))
def test_no_division_is_cheaper(prim_count, grid, seed):
    shape = {} if grid is None else {"grid": grid, "size": 1}
    prim_refs, _ = make_prim_refs(make_soup(2 * prim_count, seed=seed, **shape))
    begin = seed % prim_count
    rows = prim_refs[0][begin : begin + prim_count]
    cost, left = find_exhaustive_split(prim_refs[0], begin, prim_count)
    assert left & 1
    assert cost == pytest.approx(sum(map(cost_of, sides(rows, left))), rel=1e-12)
    for goes_left in itertools.product((0, 1), repeat=prim_count - 1):
        other = 1 + sum(bit << index for index, bit in enumerate(goes_left, 1))
        if other != (1 << prim_count) - 1:
            assert cost <= sum(map(cost_of, sides(rows, other))) * (1 + 1e-12)


@pytest.mark.parametrize(("left", "expected"), [(0b01, 1), (0b101, 2), (0b1101, 3), (0b0111, 3)])
def test_the_left_ones_are_counted(left, expected):
    assert count_left(left) == expected


@pytest.mark.parametrize("left", [0b0001, 0b0101, 0b1011, 0b1101])
def test_references_keep_their_order_on_both_sides(left):
    prim_refs, _ = make_prim_refs(make_soup(10, seed=3))
    before = prim_refs.copy()
    children = np.empty((2, BOX_LANES), np.float32)
    divide(prim_refs[0], prim_refs[1], 3, 4, left, children)
    expected = sides(before[0][3:7], left)
    assert prim_refs[1][3:7].tobytes() == np.concatenate(expected).tobytes()
    assert prim_refs[1][:3].tobytes() == before[1][:3].tobytes()
    assert prim_refs[1][7:].tobytes() == before[1][7:].tobytes()
    for child, rows in zip(children, expected, strict=True):
        lower, upper = boxes_of(rows)
        assert child[:3].tolist() == lower.min(axis=0).tolist()
        assert child[4:7].tolist() == (-upper.max(axis=0)).tolist()

import pytest

from clbvh.builders.invariants import middle_of, needs_halving
from clbvh.builders.options import MAX_DEPTH


@pytest.mark.parametrize(
    ("prim_count", "depth", "needed"),
    [
        (1, MAX_DEPTH, True),
        (1, MAX_DEPTH - 1, False),
        (2, MAX_DEPTH - 1, True),
        (2, MAX_DEPTH - 2, False),
        (3, MAX_DEPTH - 2, True),
        (4, MAX_DEPTH - 2, True),
        (5, MAX_DEPTH - 3, True),
        (4, MAX_DEPTH - 3, False),
        (2**30, MAX_DEPTH - 30, True),
        (2**30, MAX_DEPTH - 31, False),
    ],
)
def test_halving_begins_when_all_levels_are_needed(prim_count, depth, needed):
    assert needs_halving(prim_count, depth) == needed


@pytest.mark.parametrize(("begin", "end", "middle"), [(0, 2, 1), (5, 8, 6), (7, 11, 9)])
def test_the_right_half_is_the_larger_one(begin, end, middle):
    assert middle_of(begin, end) == middle

"""Exhaustive splits: of a few primitives every division in two is tried.

Most nodes of a tree are this small. Trying all divisions takes less time than filling bins, and finds the cheapest
one, which need not be a cut along an axis.
"""

from __future__ import annotations

from ...geometry.boxes import empty_box, half_area, load_box, store_box, unite
from ...support.compiled import compiled

# Four primitives can be divided in 7 ways, five in 15.
MAX_EXHAUSTIVE = 4


@compiled
def find_exhaustive_split(refs, begin, prim_count):
    """Return the cheapest division of 2 to `MAX_EXHAUSTIVE` primitives in two.

    Parameters
    ----------
    refs : (n, 8) float32
    begin, prim_count : int

    Returns
    -------
    cost : float
        Half area times count, summed over both sides.
    left_mask : int
        Bit i is set if the primitive reference at begin + i goes left. The first one always does, and of equal costs
        the division that is tried first wins.
    """
    a, b = load_box(refs, begin), load_box(refs, begin + 1)
    if prim_count == 2:
        return half_area(a) + half_area(b), 0b01

    c = load_box(refs, begin + 2)
    ab, ac, bc = unite(a, b), unite(a, c), unite(b, c)
    if prim_count == 3:
        cost, left_mask = _cheaper(half_area(a) + 2 * half_area(bc), 0b001, 2 * half_area(ab) + half_area(c), 0b011)
        return _cheaper(cost, left_mask, 2 * half_area(ac) + half_area(b), 0b101)

    d = load_box(refs, begin + 3)
    ad, bd, cd = unite(a, d), unite(b, d), unite(c, d)
    cost, left_mask = _cheaper(2 * (half_area(ab) + half_area(cd)), 0b0011, 2 * (half_area(ac) + half_area(bd)), 0b0101)
    cost, left_mask = _cheaper(cost, left_mask, 2 * (half_area(ad) + half_area(bc)), 0b1001)
    cost, left_mask = _cheaper(cost, left_mask, half_area(a) + 3 * half_area(unite(b, cd)), 0b0001)
    cost, left_mask = _cheaper(cost, left_mask, half_area(b) + 3 * half_area(unite(a, cd)), 0b1101)
    cost, left_mask = _cheaper(cost, left_mask, half_area(c) + 3 * half_area(unite(ab, d)), 0b1011)
    return _cheaper(cost, left_mask, half_area(d) + 3 * half_area(unite(ab, c)), 0b0111)


@compiled
def _cheaper(cost, left_mask, other_cost, other_left_mask):
    return (other_cost, other_left_mask) if other_cost < cost else (cost, left_mask)


@compiled
def count_left(left_mask):
    """Return how many of at most `MAX_EXHAUSTIVE` primitives go left."""
    return (left_mask & 1) + (left_mask >> 1 & 1) + (left_mask >> 2 & 1) + (left_mask >> 3 & 1)


@compiled
def divide(source, target, begin, prim_count, left_mask, boxes):
    """Copy the primitive references of a range to both sides, in their order.

    Parameters
    ----------
    source, target : (n, 8) float32
    begin, prim_count, left_mask : int
        The range and its division, see `find_exhaustive_split`.
    boxes : (2, 8) float32, written
        The boxes of both sides.
    """
    left, right = begin, begin + count_left(left_mask)
    left_box, right_box = empty_box(), empty_box()
    for index in range(prim_count):
        box = load_box(source, begin + index)
        if left_mask >> index & 1:
            store_box(target, left, box)
            left_box = unite(box, left_box)
            left += 1
        else:
            store_box(target, right, box)
            right_box = unite(box, right_box)
            right += 1
    store_box(boxes, 0, left_box)
    store_box(boxes, 1, right_box)

"""Ranges of so few primitives that every way to divide them can be tried.

Most nodes of a tree are this small. Trying all divisions takes less time than filling bins, and finds the cheapest
one, which need not be a cut along an axis.
"""

from __future__ import annotations

from numba import njit

from ..simd import empty_box, half_area, load_row, store_row, unite

# Four primitives can be divided in 7 ways, five in 15.
FEW = 4


@njit(cache=True, nogil=True)
def find_division(records, begin, prim_count):  # type: ignore[no-untyped-def]
    """Return the cheapest division of 2 to `FEW` records in two.

    Parameters
    ----------
    records : (n, 8) float32
    begin, prim_count : int

    Returns
    -------
    cost : float
        Half area times count, summed over both sides.
    left : int
        Bit i is set if record begin + i goes left. The first record always does, and of equal costs the division that
        is tried first wins.
    """
    a, b = load_row(records, begin), load_row(records, begin + 1)
    if prim_count == 2:
        return half_area(a) + half_area(b), 0b01

    c = load_row(records, begin + 2)
    ab, ac, bc = unite(a, b), unite(a, c), unite(b, c)
    if prim_count == 3:
        cost, left = _cheaper(half_area(a) + 2 * half_area(bc), 0b001, 2 * half_area(ab) + half_area(c), 0b011)
        return _cheaper(cost, left, 2 * half_area(ac) + half_area(b), 0b101)

    d = load_row(records, begin + 3)
    ad, bd, cd = unite(a, d), unite(b, d), unite(c, d)
    cost, left = _cheaper(2 * (half_area(ab) + half_area(cd)), 0b0011, 2 * (half_area(ac) + half_area(bd)), 0b0101)
    cost, left = _cheaper(cost, left, 2 * (half_area(ad) + half_area(bc)), 0b1001)
    cost, left = _cheaper(cost, left, half_area(a) + 3 * half_area(unite(b, cd)), 0b0001)
    cost, left = _cheaper(cost, left, half_area(b) + 3 * half_area(unite(a, cd)), 0b1101)
    cost, left = _cheaper(cost, left, half_area(c) + 3 * half_area(unite(ab, d)), 0b1011)
    return _cheaper(cost, left, half_area(d) + 3 * half_area(unite(ab, c)), 0b0111)


@njit(cache=True, nogil=True)
def _cheaper(cost, left, other_cost, other_left):  # type: ignore[no-untyped-def]
    return (other_cost, other_left) if other_cost < cost else (cost, left)


@njit(cache=True, nogil=True)
def count_left(left):  # type: ignore[no-untyped-def]
    """Return how many of at most `FEW` records go left."""
    return (left & 1) + (left >> 1 & 1) + (left >> 2 & 1) + (left >> 3 & 1)


@njit(cache=True, nogil=True)
def divide(source, begin, prim_count, left, target, children):  # type: ignore[no-untyped-def]
    """Copy the records of a range to both sides, in their order.

    Parameters
    ----------
    source, target : (n, 8) float32
    begin, prim_count, left : int
        The range, and what `find_division` says of it.
    children : (2, 8) float32, written
        The boxes of both sides.
    """
    to_left, to_right = begin, begin + count_left(left)
    left_box, right_box = empty_box(), empty_box()
    for index in range(prim_count):
        box = load_row(source, begin + index)
        if left >> index & 1:
            store_row(target, to_left, box)
            left_box = unite(box, left_box)
            to_left += 1
        else:
            store_row(target, to_right, box)
            right_box = unite(box, right_box)
            to_right += 1
    store_row(children, 0, left_box)
    store_row(children, 1, right_box)

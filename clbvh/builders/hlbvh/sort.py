"""Put the records of a bucket into Morton order."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...simd import LANES, centroid_of, empty_box, load_row, store_row, unite
from .codes import code_of, make_grid

# Codes are sorted by so many bits at a time: the counters fit the first-level cache.
_DIGIT_BITS = 9
_AXIS_BITS_PER_DIGIT = _DIGIT_BITS // 3

# The grid of a bucket, over its own centroids, has 64 cells along an axis when it holds few primitives, else 512.
_FEW = 4096
_DIGITS_FOR_FEW = 2
_MOST_DIGITS = 3

_DIGIT_VALUES = 1 << _DIGIT_BITS
_INDEX_BITS = 32
_INDEX_MASK = (1 << _INDEX_BITS) - 1


@njit(cache=True, nogil=True)
def sort_records(rows, first_row, count, records, codes, keys, other_keys):  # type: ignore[no-untyped-def]
    """Copy records in Morton order; those in one cell keep their order.

    Parameters
    ----------
    rows : (k, 8) float32
        The records are `rows[first_row : first_row + count]`.
    records : (>= count, 8) float32, written
    codes : (>= count,) int32, written
        The Morton code of each copied record.
    keys, other_keys : (>= count,) int64, scratch
    """
    bounds = np.empty((1, LANES), np.float32)
    centroid_box = empty_box()
    for row in range(first_row, first_row + count):
        centroid_box = unite(centroid_of(load_row(rows, row)), centroid_box)
    store_row(bounds, 0, centroid_box)
    digits = _DIGITS_FOR_FEW if count <= _FEW else _MOST_DIGITS
    grid = make_grid(bounds, 0, _AXIS_BITS_PER_DIGIT * digits)
    lower, scales = load_row(grid, 0), load_row(grid, 1)

    # Code above, place below; and how often each digit has each value.
    counts = np.zeros((digits, _DIGIT_VALUES), np.int64)
    for index in range(count):
        code = code_of(load_row(rows, first_row + index), lower, scales)
        keys[index] = code << _INDEX_BITS | index
        for digit in range(digits):
            counts[digit, code >> digit * _DIGIT_BITS & (_DIGIT_VALUES - 1)] += 1

    # Last digit first.
    for digit in range(digits):
        place = 0
        for value in range(_DIGIT_VALUES):
            place, counts[digit, value] = place + counts[digit, value], place
        shift = _INDEX_BITS + digit * _DIGIT_BITS
        for index in range(count):
            key = keys[index]
            value = key >> shift & (_DIGIT_VALUES - 1)
            other_keys[counts[digit, value]] = key
            counts[digit, value] += 1
        keys, other_keys = other_keys, keys

    for index in range(count):
        codes[index] = keys[index] >> _INDEX_BITS
        store_row(records, index, load_row(rows, first_row + (keys[index] & _INDEX_MASK)))

"""Put the primitive references of a treelet into Morton order."""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import centroid_of, empty_box, load_box, store_box, unite
from ...structs import BOX_LANES
from ...support.compiled import compiled
from .codes import code_of, make_grid

# Bits of a digit of the radix sort: its counters fit the first-level cache.
_DIGIT_BITS = 9
_AXIS_BITS_PER_DIGIT = _DIGIT_BITS // 3

# The grid of a treelet, over its own centroids, has 64 cells along an axis when it holds few primitives, else 512.
_SMALL_TREELET = 4096
_SMALL_DIGITS = 2
_MOST_DIGITS = 3

_DIGIT_VALUES = 1 << _DIGIT_BITS
_INDEX_BITS = 32
_INDEX_MASK = (1 << _INDEX_BITS) - 1


@compiled
def sort_prim_refs(source, first, count, refs, codes, keys, other_keys):
    """Copy primitive references in Morton order; those in one cell keep their order.

    Parameters
    ----------
    source : (k, 8) float32
        The primitive references are `source[first : first + count]`.
    refs : (>= count, 8) float32, written
    codes : (>= count,) int32, written
        The Morton code of each copied reference.
    keys, other_keys : (>= count,) int64, scratch
    """
    bounds = np.empty((1, BOX_LANES), np.float32)
    centroid_box = empty_box()
    for index in range(first, first + count):
        centroid_box = unite(centroid_of(load_box(source, index)), centroid_box)
    store_box(bounds, 0, centroid_box)
    digits = _SMALL_DIGITS if count <= _SMALL_TREELET else _MOST_DIGITS
    grid = make_grid(bounds, 0, _AXIS_BITS_PER_DIGIT * digits)
    lower, scales = load_box(grid, 0), load_box(grid, 1)

    # Keys: the code above, the index below. Counts: how often each digit has each value.
    counts = np.zeros((digits, _DIGIT_VALUES), np.int64)
    for index in range(count):
        code = code_of(load_box(source, first + index), lower, scales)
        keys[index] = code << _INDEX_BITS | index
        for digit in range(digits):
            counts[digit, code >> digit * _DIGIT_BITS & (_DIGIT_VALUES - 1)] += 1

    # Last digit first.
    for digit in range(digits):
        begin = 0
        for value in range(_DIGIT_VALUES):
            begin, counts[digit, value] = begin + counts[digit, value], begin
        shift = _INDEX_BITS + digit * _DIGIT_BITS
        for index in range(count):
            key = keys[index]
            value = key >> shift & (_DIGIT_VALUES - 1)
            other_keys[counts[digit, value]] = key
            counts[digit, value] += 1
        keys, other_keys = other_keys, keys

    for index in range(count):
        codes[index] = keys[index] >> _INDEX_BITS
        store_box(refs, index, load_box(source, first + (keys[index] & _INDEX_MASK)))

"""A radix sort by keys of 24 bits: a counting sort by the lower half, then one by the upper half.

Both passes are stable, so the result does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .host_threads import HostThreads

KEY_BITS = 24
_DIGIT_BITS = KEY_BITS // 2
_DIGIT_MASK = (1 << _DIGIT_BITS) - 1

# The largest key, with an upper digit of its own: items with this key come last.
LAST_KEY = 1 << KEY_BITS
_DIGIT_COUNT = (1 << _DIGIT_BITS) + 1

# A pair is a key and an item's index in 64 bits; this many bits are the index.
_INDEX_BITS = 32


def order_by_keys(
    item_count: int, threads: HostThreads, make_keys: Callable[[int, int, NDArray[np.int32]], None]
) -> NDArray[np.int32]:
    """Return (item_count,) int32: the indices of the items in the order of their keys.

    Parameters
    ----------
    item_count : int
    threads : HostThreads
    make_keys : function
        ``make_keys(begin, end, keys)`` writes the keys of items begin to end - 1, each from 0 to `LAST_KEY`; called
        from several threads.
    """
    keys, pairs, order = np.empty(item_count, np.int32), np.empty(item_count, np.int64), np.empty(item_count, np.int32)
    ranges = threads.ranges(item_count)
    counts = np.zeros((2, len(ranges), _DIGIT_COUNT), np.int32)

    def make_and_count(number: int, begin: int, end: int) -> None:
        make_keys(begin, end, keys[begin:end])
        _count_lower(keys[begin:end], counts[0, number])

    threads.run(make_and_count, [(number, *bounds) for number, bounds in enumerate(ranges)])
    starts = _find_starts(counts[0])
    threads.run(_sort_lower, [(keys, *bounds, starts[number], pairs) for number, bounds in enumerate(ranges)])
    threads.run(_count_upper, [(pairs, *bounds, counts[1, number]) for number, bounds in enumerate(ranges)])
    starts = _find_starts(counts[1])
    threads.run(_sort_upper, [(pairs, *bounds, starts[number], order) for number, bounds in enumerate(ranges)])
    return order


def _find_starts(counts: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the index of each range's first item with each digit; both arrays are (ranges, digits)."""
    by_digit: NDArray[Any] = np.ascontiguousarray(counts.T)
    sums = np.cumsum(by_digit, dtype=np.int32).reshape(by_digit.shape)
    return np.ascontiguousarray((sums - by_digit).T)


@compiled
def _count_lower(keys, counts):
    for index in range(len(keys)):
        counts[keys[index] & _DIGIT_MASK] += 1


@compiled
def _sort_lower(keys, begin, end, starts, pairs):
    for index in range(begin, end):
        key = keys[index]
        digit = key & _DIGIT_MASK
        pairs[starts[digit]] = np.int64(key) << _INDEX_BITS | index
        starts[digit] += 1


@compiled
def _count_upper(pairs, begin, end, counts):
    for slot in range(begin, end):
        counts[pairs[slot] >> _INDEX_BITS + _DIGIT_BITS] += 1


@compiled
def _sort_upper(pairs, begin, end, starts, order):
    for slot in range(begin, end):
        digit = pairs[slot] >> _INDEX_BITS + _DIGIT_BITS
        order[starts[digit]] = np.int32(pairs[slot])  # the lower half: the item's index
        starts[digit] += 1

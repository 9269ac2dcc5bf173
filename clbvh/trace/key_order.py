"""An order by keys of 24 bits: a counting sort by the lower half, then by the upper half.

Both keep what is equal in its order, so the result does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..host_threads import HostThreads

KEY_BITS = 24
_DIGIT_BITS = KEY_BITS // 2
_DIGIT_MASK = (1 << _DIGIT_BITS) - 1

# The largest key: what has it comes last, with an upper half of its own.
LAST_KEY = 1 << KEY_BITS
_BUCKETS = (1 << _DIGIT_BITS) + 1

# A key and the number of its row in 64 bits.
_NUMBER_BITS = 32


def order_by_keys(
    row_count: int, threads: HostThreads, make_keys: Callable[[int, int, NDArray[np.int32]], None]
) -> NDArray[np.int32]:
    """Return (row_count,) int32: the rows in the order of their keys.

    Parameters
    ----------
    row_count : int
    threads : HostThreads
    make_keys : function
        Called with where a range of rows begins and ends, and the array to write their keys to, from 0 to `LAST_KEY`;
        from several threads.
    """
    keys, pairs, order = np.empty(row_count, np.int32), np.empty(row_count, np.int64), np.empty(row_count, np.int32)
    ranges = threads.ranges(row_count)
    tallies = np.zeros((2, len(ranges), _BUCKETS), np.int32)

    def make_and_count(place: int, begin: int, end: int) -> None:
        make_keys(begin, end, keys[begin:end])
        _count_lower(keys[begin:end], tallies[0, place])

    threads.run(make_and_count, [(place, *rows) for place, rows in enumerate(ranges)])
    starts = _find_starts(tallies[0])
    threads.run(_sort_lower, [(keys, *rows, starts[place], pairs) for place, rows in enumerate(ranges)])
    threads.run(_count_upper, [(pairs, *rows, tallies[1, place]) for place, rows in enumerate(ranges)])
    starts = _find_starts(tallies[1])
    threads.run(_sort_upper, [(pairs, *rows, starts[place], order) for place, rows in enumerate(ranges)])
    return order


def _find_starts(tallies: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return where each range puts its first row of each bucket; the tallies have a row for each range."""
    by_bucket: NDArray[Any] = np.ascontiguousarray(tallies.T)
    sums = np.cumsum(by_bucket, dtype=np.int32).reshape(by_bucket.shape)
    return np.ascontiguousarray((sums - by_bucket).T)


@njit(cache=True, nogil=True)
def _count_lower(keys, tally):  # type: ignore[no-untyped-def]
    for row in range(len(keys)):
        tally[keys[row] & _DIGIT_MASK] += 1


@njit(cache=True, nogil=True)
def _sort_lower(keys, begin, end, starts, pairs):  # type: ignore[no-untyped-def]
    for row in range(begin, end):
        key = keys[row]
        digit = key & _DIGIT_MASK
        pairs[starts[digit]] = np.int64(key) << _NUMBER_BITS | row
        starts[digit] += 1


@njit(cache=True, nogil=True)
def _count_upper(pairs, begin, end, tally):  # type: ignore[no-untyped-def]
    for place in range(begin, end):
        tally[pairs[place] >> _NUMBER_BITS + _DIGIT_BITS] += 1


@njit(cache=True, nogil=True)
def _sort_upper(pairs, begin, end, starts, order):  # type: ignore[no-untyped-def]
    for place in range(begin, end):
        digit = pairs[place] >> _NUMBER_BITS + _DIGIT_BITS
        order[starts[digit]] = np.int32(pairs[place])  # the lower half: the row's number
        starts[digit] += 1

"""The order of many items by small keys, for rays and points that are cast where their neighbours are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .host_threads import HostThreads

# A pair is a key and an item's index in 64 bits; this many bits are the index.
_INDEX_BITS = 32


def order_by_keys(
    item_count: int, threads: HostThreads, make_keys: Callable[[int, int, NDArray[np.int32]], None]
) -> NDArray[np.int32]:
    """Return (item_count,) int32: the indices of the items in the order of their keys, equal ones in their own order.

    Parameters
    ----------
    item_count : int
    threads : HostThreads
    make_keys : function
        ``make_keys(begin, end, keys)`` writes the keys of items begin to end - 1, from 0; called from several threads.
    """
    keys, pairs = np.empty(item_count, np.int32), np.arange(item_count)

    def make_pairs(begin: int, end: int) -> None:
        make_keys(begin, end, keys[begin:end])
        pairs[begin:end] |= keys[begin:end].astype(np.int64) << _INDEX_BITS

    threads.for_ranges(item_count, make_pairs)
    # Numbers of 64 bits are sorted five times as fast as the order of numbers is found.
    pairs.sort()
    return pairs.astype(np.int32)

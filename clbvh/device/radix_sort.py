"""A stable sort of pairs on a device, by the digits of their keys from the lowest on; see cl/kernels/radix_sort.cl."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .host.variants import SORT_DIGIT_BITS
from .session import DeviceSession

PAIR_BYTES = 8

# The keys are above the numbers of the items.
_KEY_SHIFT = 32


class SortPlan(NamedTuple):
    """Tunables of the sort on a device; the result does not depend on them.

    Attributes
    ----------
    digit_bits : int
        Bits of the keys that one pass sorts by.
    group_size : int
        Work-items of a work-group, which has one chunk.
    item_pairs : int
        Most pairs of a work-item.
    """

    digit_bits: int
    group_size: int
    item_pairs: int


# A CPU's core counts many digits in its cache, one pair after the other, and writes to as many places. An item of a GPU
# has few counters in the memory of its group. Digits of 8 or 11 bits are no faster (a million pairs, 2-core x86-64
# server).
CPU_PLAN = SortPlan(digit_bits=SORT_DIGIT_BITS, group_size=1, item_pairs=1 << 16)
GPU_PLAN = SortPlan(digit_bits=4, group_size=128, item_pairs=16)


def sort_pairs(
    session: DeviceSession,
    pairs: Any,
    count: int,
    key_bits: int,
    plan: SortPlan | None = None,
    take: Callable[[str, int], Any] | None = None,
) -> Any:
    """Sort pairs by their keys, equal ones in their own order.

    Parameters
    ----------
    session : DeviceSession
    pairs : buffer of (count,) uint64
        Keys in the upper 32 bits; overwritten.
    count : int
    key_bits : int
        The keys are below 2^key_bits; 32 at most.
    plan : SortPlan, optional
        By default the one that suits the device.
    take : function, optional
        Returns a buffer for a name and a size in bytes; by default a new one.

    Returns
    -------
    buffer of (count,) uint64
        The sorted pairs, in the given buffer or in another one.

    Raises
    ------
    DeviceError
        The device has no room for as many pairs again.
    """
    plan = plan or (CPU_PLAN if session.info.kind == "cpu" else GPU_PLAN)
    kernels = session.kernels("radix_sort", {"DIGIT_BITS": plan.digit_bits, "GROUP_SIZE": plan.group_size})
    item_pairs = plan.item_pairs
    if plan.group_size == 1:
        # As many chunks as a CPU's cores can share evenly, none of which has fewer pairs than digits.
        even = -(-count // (4 * session.info.compute_units))
        item_pairs = min(item_pairs, max(even, 1 << plan.digit_bits))
    chunk_size = plan.group_size * item_pairs
    chunk_count = -(-count // chunk_size)
    count_count = chunk_count << plan.digit_bits
    take = take or (lambda name, size: session.allocate(size))
    counts, other = take("counts", 4 * count_count), take("sorted", PAIR_BYTES * count)
    group = (plan.group_size,)
    for shift in range(_KEY_SHIFT, _KEY_SHIFT + key_bits, plan.digit_bits):
        shared = {
            "pairs": pairs,
            "pair_count": np.int32(count),
            "chunk_size": np.int32(chunk_size),
            "chunk_count": np.int32(chunk_count),
            "shift": np.int32(shift),
            "counts": counts,
        }
        session.run(kernels["count_digits"], (chunk_count * plan.group_size,), group, **shared)
        session.run(kernels["sum_counts"], group, group, counts=counts, count=np.int32(count_count))
        session.run(kernels["scatter_pairs"], (chunk_count * plan.group_size,), group, **shared, sorted=other)
        pairs, other = other, pairs
    return pairs

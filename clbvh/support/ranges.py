"""Half-open ranges, cut into parts of nearly equal size."""

from __future__ import annotations

from itertools import pairwise


def cut_range(begin: int, end: int, count: int) -> list[tuple[int, int]]:
    """Cut the range from `begin` to `end` into `count` ranges that cover it once; some are empty when it is short."""
    size = end - begin
    return list(pairwise(begin + size * number // count for number in range(count + 1)))

"""Host loops over many rows, cut into one range for each core. The loops are compiled and release Python's lock."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from ..closing import Closing

# Fewer rows than this for each thread are not worth waking it, which takes about 60 us: some 6,000 rays' packing on a
# 2-core x86-64 server.
_LEAST_ROWS = 1 << 15


class HostThreads(Closing):
    """Threads that start when there is work for them, and stay until they are closed."""

    def __init__(self) -> None:
        self._core_count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._pool: ThreadPoolExecutor | None = None

    def for_ranges(self, row_count: int, task: Callable[[int, int], None]) -> None:
        """Call ``task(begin, end)`` for ranges that cover all rows once, side by side where that pays.

        An exception of the first range that has one is raised, after all have ended.
        """
        range_count = max(1, min(self._core_count, row_count // _LEAST_ROWS))
        bounds = [row_count * place // range_count for place in range(range_count + 1)]
        if range_count > 1 and self._pool is None:
            self._pool = ThreadPoolExecutor(self._core_count - 1, thread_name_prefix="clbvh")
        others = [self._pool.submit(task, *part) for part in itertools.pairwise(bounds[1:]) if self._pool is not None]
        try:
            task(bounds[0], bounds[1])
        finally:
            errors = [other.exception() for other in others]
        for error in errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

"""Host loops over many rows, cut into one range for each core. The loops are compiled and release Python's lock."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

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
        self.run(task, list(itertools.pairwise(bounds)))

    def run(self, task: Callable[..., None], argument_lists: Sequence[tuple[Any, ...]]) -> None:
        """Call a task with each of several lists of arguments, side by side; see `for_ranges`."""
        if len(argument_lists) > 1 and self._pool is None:
            self._pool = ThreadPoolExecutor(max(1, self._core_count - 1), thread_name_prefix="clbvh")
        others = [self._pool.submit(task, *arguments) for arguments in argument_lists[1:] if self._pool is not None]
        errors: list[BaseException | None] = []
        try:
            for arguments in argument_lists[:1]:
                task(*arguments)
            # What nobody has begun yet is done here.
            for other, arguments in zip(reversed(others), reversed(argument_lists[1:]), strict=True):
                if other.cancel():
                    task(*arguments)
        finally:
            errors = [other.exception() for other in others if not other.cancelled()]
        for error in errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

"""A persistent thread pool for compiled loops, which release the GIL while they run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

from .context_manager import ContextManager
from .ranges import cut_range

_Result = TypeVar("_Result")

# Least items of a thread's range. Waking a thread takes about 60 us, as long as packing 6,000 rays on a 2-core x86-64
# server.
_LEAST_ITEMS = 1 << 15


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class HostThreads(ContextManager):
    """Threads that start with their first task and end when they are closed.

    Parameters
    ----------
    count : int, optional
        Threads that work at the same time, including the calling one; the number of usable processors without it.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()
        self._pool: ThreadPoolExecutor | None = None

    def for_ranges(self, item_count: int, task: Callable[[int, int], None]) -> None:
        """Call ``task(begin, end)`` for ranges that cover all items once, in parallel where that pays; see `run`."""
        self.run(task, self.ranges(item_count))

    def ranges(self, item_count: int) -> list[tuple[int, int]]:
        """Return ranges that cover all items once, as many as are worth a thread each."""
        return cut_range(0, item_count, max(1, min(self.count, item_count // _LEAST_ITEMS)))

    def run(self, task: Callable[..., _Result], argument_lists: Sequence[tuple[Any, ...]]) -> list[_Result]:
        """Return ``task(*arguments)`` for each list of arguments, computed in parallel, in their order.

        If tasks raise, the exception of the first of them is raised after all have ended.
        """
        if self.count == 1 or len(argument_lists) <= 1:
            return [task(*arguments) for arguments in argument_lists]
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.count - 1, thread_name_prefix="clbvh")
        # The calling thread takes the first task; the others wait for the pool's threads.
        futures = [self._pool.submit(task, *arguments) for arguments in argument_lists[1:]]
        results: dict[int, _Result] = {}
        try:
            results[0] = task(*argument_lists[0])
            # Tasks that no thread has begun run here, the last ones first.
            for index in range(len(futures), 0, -1):
                if futures[index - 1].cancel():
                    results[index] = task(*argument_lists[index])
        finally:
            wait([future for future in futures if not future.cancelled()])
        for index, future in enumerate(futures, start=1):
            if index not in results:
                results[index] = future.result()
        return [results[index] for index in range(len(argument_lists))]

    def close(self) -> None:
        """End the threads. Closing twice is allowed."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

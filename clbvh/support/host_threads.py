"""Threads of this process that stay, for compiled loops: those release Python's lock while they run."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from .closing import Closing

_Result = TypeVar("_Result")

# Fewer rows than this for each thread are not worth waking it, which takes about 60 us: some 6,000 rays' packing on a
# 2-core x86-64 server.
_LEAST_ROWS = 1 << 15


def usable_cores() -> int:
    """Return the number of processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class HostThreads(Closing):
    """Threads that start when there is work for them, and stay until they are closed.

    Parameters
    ----------
    count : int, optional
        How many work at the same time, the calling one included; the number of usable processors without it.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()
        self._pool: ThreadPoolExecutor | None = None

    def for_ranges(self, row_count: int, task: Callable[[int, int], None]) -> None:
        """Call ``task(begin, end)`` for ranges that cover all rows once, side by side where that pays; see `run`."""
        self.run(task, self.ranges(row_count))

    def ranges(self, row_count: int) -> list[tuple[int, int]]:
        """Return where ranges begin and end that cover all rows once: as many as are worth a thread each."""
        range_count = max(1, min(self.count, row_count // _LEAST_ROWS))
        bounds = [row_count * place // range_count for place in range(range_count + 1)]
        return list(itertools.pairwise(bounds))

    def run(self, task: Callable[..., _Result], argument_lists: Sequence[tuple[Any, ...]]) -> list[_Result]:
        """Return ``task(*arguments)`` for each list of arguments, in their order, worked on side by side.

        An exception of the first that has one is raised, after all have ended.
        """
        if self.count == 1 or len(argument_lists) <= 1:
            return [task(*arguments) for arguments in argument_lists]
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.count - 1, thread_name_prefix="clbvh")
        first, *rest = argument_lists
        others = [self._pool.submit(task, *arguments) for arguments in rest]
        mine: dict[int, _Result] = {}
        try:
            mine[0] = task(*first)
            # What nobody has begun yet is done here.
            for place in range(len(rest), 0, -1):
                if others[place - 1].cancel():
                    mine[place] = task(*rest[place - 1])
        finally:
            for other in others:
                if not other.cancelled():
                    other.exception()  # waits for it
        return [mine[place] if place in mine else others[place - 1].result() for place in range(len(argument_lists))]

    def close(self) -> None:
        """End the threads. Closing twice is allowed."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

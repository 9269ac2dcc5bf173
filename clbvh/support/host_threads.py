"""A persistent thread pool for compiled loops, which release the GIL while they run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise
from queue import SimpleQueue
from typing import Any, TypeVar

from .context_manager import ContextManager

_Result = TypeVar("_Result")

# Least items of a thread's range. Waking a thread takes about 60 us, as long as packing 6,000 rays on a 2-core x86-64
# server.
_LEAST_ITEMS = 1 << 15


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cut_range(begin: int, end: int, count: int) -> list[tuple[int, int]]:
    """Cut the range from `begin` to `end` into `count` ranges that cover it once; some are empty when it is short."""
    size = end - begin
    return list(pairwise(begin + size * number // count for number in range(count + 1)))


def side_by_side(*steps: Callable[[], Any]) -> list[Any]:
    """Return the results of functions that run at the same time; errors and Ctrl-C are as in `HostThreads.run`."""
    with HostThreads(len(steps)) as threads:
        return threads.run(lambda step: step(), [(step,) for step in steps])


class HostThreads(ContextManager):
    """Threads that start with their first task and end when they are closed; any thread may use them.

    Parameters
    ----------
    count : int, optional
        Threads that work at the same time, including the calling one; the number of usable processors without it.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()
        self._open_pool()

    def for_ranges(self, item_count: int, task: Callable[[int, int], None]) -> None:
        """Call ``task(begin, end)`` for ranges that cover all items once, in parallel where that pays; see `run`."""
        self.run(task, self.ranges(item_count))

    def ranges(self, item_count: int) -> list[tuple[int, int]]:
        """Return ranges that cover all items once, as many as are worth a thread each."""
        return cut_range(0, item_count, max(1, min(self.count, item_count // _LEAST_ITEMS)))

    def run(self, task: Callable[..., _Result], argument_lists: Sequence[tuple[Any, ...]]) -> list[_Result]:
        """Return ``task(*arguments)`` for each list of arguments, computed in parallel, in their order.

        If tasks raise, the exception of the first of them is raised after all have ended. After Ctrl-C, too, no task
        is running any more.
        """
        if self.count == 1 or len(argument_lists) <= 1:
            return [task(*arguments) for arguments in argument_lists]
        waiting = list(enumerate(argument_lists))[::-1]  # taken from the end: the first task comes first
        results: dict[int, _Result] = {}
        errors: dict[int, Exception] = {}
        helping: list[bool] = []  # one item for each helper at work, put there before it takes a task
        endings: SimpleQueue[None] = SimpleQueue()

        def work() -> None:
            with suppress(IndexError):
                while waiting:
                    index, arguments = waiting.pop()
                    try:
                        results[index] = task(*arguments)
                    except Exception as error:
                        errors[index] = error

        def help_out() -> None:
            helping.append(True)
            try:
                work()
            finally:
                helping.pop()
                endings.put(None)

        try:
            self._submit(help_out, min(self.count, len(argument_lists)) - 1)
            work()
        finally:
            waiting.clear()
            _wait(helping, endings)
        if errors:
            error = errors[min(errors)]
            errors.clear()
            try:
                raise error
            finally:
                del error  # its traceback holds this frame: a cycle, which would keep arrays alive
        return [results[index] for index in range(len(argument_lists))]

    def close(self) -> None:
        """End the threads after the tasks that they run. Closing twice is allowed; the next task starts new ones."""
        if self._process_id == os.getpid():
            pool = self._pool
            self._open_pool()
            pool.shutdown()

    def _submit(self, function: Callable[[], None], count: int) -> None:
        """Let some threads call a function, or fewer: the calling one does all that is left."""
        if self._process_id != os.getpid():  # a forked child has no threads, and nobody would release their locks
            self._open_pool()
        with suppress(RuntimeError):  # the system has no more threads, or the pool was closed meanwhile
            for _ in range(count):
                self._pool.submit(function)

    def _open_pool(self) -> None:
        self._pool, self._process_id = ThreadPoolExecutor(max(1, self.count - 1), "clbvh"), os.getpid()


def _wait(helping: list[bool], endings: SimpleQueue[None]) -> None:
    """Return when no helper is at work; Ctrl-C meanwhile is raised then."""
    try:
        while helping:
            endings.get()
    except KeyboardInterrupt:
        _wait(helping, endings)
        raise

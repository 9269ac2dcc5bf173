"""A persistent thread pool for compiled loops, which release the GIL while they run.

Only locks and queues written in C: Ctrl-C that strikes inside a `threading.Condition` or a semaphore, as in
`concurrent.futures`, can leave its lock taken for ever.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from ..errors import PoolError
from .context_manager import ContextManager
from .forks import make_lock, renew_in_child

_Result = TypeVar("_Result")
_Jobs = SimpleQueue[Callable[[], None] | None]

# Least items of a thread's range, where the caller names no number. Waking a thread takes about 60 us on a 2-core
# x86-64 server.
LEAST_ITEMS = 1 << 15


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
        self._lock = make_lock()
        self._forget_threads()
        renew_in_child(self)

    def for_ranges(self, item_count: int, task: Callable[[int, int], None], *, least_items: int = LEAST_ITEMS) -> None:
        """Call ``task(begin, end)`` for ranges that cover all items once, in parallel where that pays; see `run`.

        `least_items` of a range are worth a thread.
        """
        if item_count < 2 * least_items:  # lists of one range would cost a call with one ray 3 % of its time
            task(0, item_count)
        else:
            self.run(task, self.ranges(item_count, least_items))

    def ranges(self, item_count: int, least_items: int = LEAST_ITEMS) -> list[tuple[int, int]]:
        """Return ranges that cover all items once, as many as are worth a thread each."""
        return cut_range(0, item_count, max(1, min(self.count, item_count // least_items)))

    def run(self, task: Callable[..., _Result], argument_lists: Sequence[tuple[Any, ...]]) -> list[_Result]:
        """Return ``task(*arguments)`` for each list of arguments, computed in parallel, in their order.

        If tasks raise, the exception of the first of them is raised after all have ended. After Ctrl-C, too, no task
        is running any more.
        """
        if self.count == 1 or len(argument_lists) <= 1:
            return [task(*arguments) for arguments in argument_lists]
        pending = list(enumerate(argument_lists))[::-1]  # taken from the end: the first task comes first
        results: dict[int, _Result] = {}
        errors: dict[int, Exception] = {}
        helping: list[bool] = []  # one item for each helper at work, put there before it takes a task
        endings: SimpleQueue[None] = SimpleQueue()
        process_id = os.getpid()

        def work() -> None:
            with suppress(IndexError):
                while pending:
                    index, arguments = pending.pop()
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
            self._wake(help_out, min(self.count, len(argument_lists)) - 1)
            work()
        finally:
            pending.clear()
            if os.getpid() == process_id:
                _wait(helping, endings)
        if errors:
            error = errors[min(errors)]
            errors.clear()
            try:
                raise error
            finally:
                del error  # its traceback holds this frame: a cycle, which would keep arrays alive
        if len(results) < len(argument_lists):
            raise PoolError("this process was forked inside a task, and has none of the threads that worked beside it")
        return [results[index] for index in range(len(argument_lists))]

    def close(self) -> None:
        """End the threads after the tasks that they run. Closing twice is allowed; the next task starts new ones."""
        with self._lock:
            stop, threads = self._stop, self._threads
            self._forget_threads()
        stop()
        for thread in threads:
            thread.join()

    def _wake(self, function: Callable[[], None], count: int) -> None:
        """Let some threads call a function, or fewer: the calling one does all that is left."""
        with self._lock:
            with suppress(RuntimeError):  # the system has no more threads
                while len(self._threads) < count:
                    thread = Thread(target=_serve, args=(self._jobs,), name="clbvh", daemon=True)
                    thread.start()
                    self._threads.append(thread)
            for _ in self._threads[:count]:
                self._jobs.put(function)

    def start_anew(self) -> None:
        """See `Renewable`."""
        self._stop.detach()
        self._forget_threads()

    def _forget_threads(self) -> None:
        self._jobs: _Jobs = SimpleQueue()
        self._threads: list[Thread] = []
        # Also called when this object is garbage.
        self._stop = weakref.finalize(self, _stop_threads, self._jobs, self._threads)


def _serve(jobs: _Jobs) -> None:
    """Do jobs until one is None; the life of a thread."""
    while (job := jobs.get()) is not None:
        job()
        del job  # and the arrays that it holds


def _stop_threads(jobs: _Jobs, threads: list[Thread]) -> None:
    """Let threads end after the jobs before."""
    for _ in threads:
        jobs.put(None)


def _wait(helping: list[bool], endings: SimpleQueue[None]) -> None:
    """Return when no helper is at work; Ctrl-C meanwhile is raised then."""
    try:
        while helping:
            endings.get()
    except KeyboardInterrupt:
        _wait(helping, endings)
        raise

"""A persistent thread pool for compiled loops, which release the GIL while they run.

Only locks and queues written in C: Ctrl-C that strikes inside a `threading.Condition` or a semaphore, as in
`concurrent.futures`, can leave its lock taken for ever.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence
from itertools import pairwise
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar

from .context_manager import ContextManager

_Result = TypeVar("_Result")
_Jobs = SimpleQueue[Callable[[], None] | None]

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
        self._start_anew()

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
        batch = _Batch(task, argument_lists)
        try:
            self._wake(batch.help, min(self.count, len(argument_lists)) - 1)
            batch.work()
        finally:
            batch.finish()
        return batch.results()

    def close(self) -> None:
        """End the threads after the tasks that they run. Closing twice is allowed; the next task starts new ones."""
        if self._process_id != os.getpid():
            return
        with self._lock:
            stop, threads = self._stop, self._threads
            self._start_anew(self._lock)
        stop()
        for thread in threads:
            thread.join()

    def _wake(self, work: Callable[[], None], count: int) -> None:
        """Let some threads of the pool call a function."""
        if self._process_id != os.getpid():  # a forked child has no threads, and nobody would release the lock
            self._start_anew()
        with self._lock:
            while len(self._threads) < count:
                thread = Thread(target=_serve, args=(self._jobs,), name="clbvh", daemon=True)
                try:
                    thread.start()
                except RuntimeError:  # the system has no more; the calling thread does what is left
                    break
                self._threads.append(thread)
            for _ in self._threads[:count]:
                self._jobs.put(work)

    def _start_anew(self, lock: Any = None) -> None:
        """Forget all threads."""
        self._lock, self._process_id = lock or Lock(), os.getpid()
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


class _Batch(Generic[_Result]):
    """Tasks that the calling thread and helpers take, one after the other."""

    def __init__(self, task: Callable[..., _Result], argument_lists: Sequence[tuple[Any, ...]]) -> None:
        self._task = task
        self._argument_lists = argument_lists
        self._results: dict[int, _Result] = {}
        self._errors: dict[int, Exception] = {}
        self._lock = Lock()
        self._waiting = list(range(len(argument_lists)))[::-1]  # taken from the end: the first task comes first
        self._helped: set[int] = set()  # tasks that helpers are running
        self._endings: SimpleQueue[None] = SimpleQueue()  # gets an item with the end of each of them

    def work(self) -> None:
        """Run tasks until none is left, in the calling thread."""
        while (index := self._take()) is not None:
            self._run(index)

    def help(self) -> None:
        """Run tasks until none is left, in another thread."""
        while (index := self._take(self._helped)) is not None:
            try:
                self._run(index)
            finally:
                self._helped.discard(index)
                self._endings.put(None)

    def finish(self) -> None:
        """Return when no helper is running a task, and none will; Ctrl-C meanwhile is raised then."""
        with self._lock:
            self._waiting.clear()
        interrupt = None
        while self._helped:
            try:
                self._endings.get()
            except KeyboardInterrupt as error:
                interrupt = error
        if interrupt is not None:
            try:
                raise interrupt
            finally:
                del interrupt  # as in `results`

    def results(self) -> list[_Result]:
        """Return the results in the order of the tasks, or raise the exception of the first that failed."""
        if self._errors:
            error = self._errors[min(self._errors)]
            self._errors.clear()
            try:
                raise error
            finally:
                del error  # its traceback holds this frame: a cycle, which would keep arrays alive
        return [self._results[index] for index in range(len(self._argument_lists))]

    def _take(self, taken: set[int] | None = None) -> int | None:
        """Take the next task; None if there is none."""
        with self._lock:
            if not self._waiting:
                return None
            index = self._waiting.pop()
            if taken is not None:
                taken.add(index)
            return index

    def _run(self, index: int) -> None:
        try:
            self._results[index] = self._task(*self._argument_lists[index])
        except Exception as error:
            self._errors[index] = error

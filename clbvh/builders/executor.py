"""Who runs the steps of a build: threads of the calling process, or the worker processes of a pool.

A build does not know which. An executor owns the arrays of one build, by name, for as long as it takes. A step is a
function at the top level of a module, ``step(arrays, *task)``: it sees all arrays, gets small arguments and returns
small results.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..support.context_manager import ContextManager
from ..support.host_threads import HostThreads

Arrays = Mapping[str, NDArray[Any]]
Step = Callable[..., Any]
Task = tuple[Any, ...]


class Executor(ContextManager, ABC):
    """Some workers, and arrays that all of them see.

    Attributes
    ----------
    workers : int
    threads : HostThreads
        As many threads of the calling process, for steps that are too short for a message to another process.
    arrays : dict of str to array
    """

    def __init__(self, threads: HostThreads) -> None:
        self.threads = threads
        self.workers = threads.count
        self.arrays: dict[str, NDArray[Any]] = {}

    @abstractmethod
    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a new array with arbitrary contents, which outlives the build.

        Raises
        ------
        PoolError
            There is not enough memory to share.
        """

    @abstractmethod
    def share(self, name: str, array: NDArray[Any]) -> None:
        """Let all steps read an array that exists."""

    @abstractmethod
    def discard(self, *names: str) -> None:
        """Let go of arrays that no later step needs."""

    @abstractmethod
    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:
        """Return ``step(arrays, *task)`` for each task; tasks begin in the order given.

        Raises
        ------
        PoolError
            A step raised in a worker process, or one of them died.
        """

    @abstractmethod
    def run_on_each(self, step: Step, *task: Any) -> list[Any]:
        """Run a step once in every process that has run steps; return the results."""


class ThreadExecutor(Executor):
    """Threads of the calling process, which take no time to start.

    Parameters
    ----------
    workers : int
        Threads, with the calling one.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(HostThreads(workers))

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a new array."""
        self.arrays[name] = np.empty(shape, dtype)
        return self.arrays[name]

    def share(self, name: str, array: NDArray[Any]) -> None:
        """Let steps read the array itself."""
        self.arrays[name] = np.ascontiguousarray(array)

    def discard(self, *names: str) -> None:
        """Let go of arrays."""
        for name in names:
            del self.arrays[name]

    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:
        """Run tasks in the threads; the first of their errors is raised as it is."""
        return self.threads.run(step, [(self.arrays, *task) for task in tasks])

    def run_on_each(self, step: Step, *task: Any) -> list[Any]:
        """Run a step once: the threads share all that a step can leave behind."""
        return [step(self.arrays, *task)]

    def close(self) -> None:
        """End the threads."""
        self.threads.close()

"""Who runs the steps of a build: the calling process, or the workers of a pool. A build does not know which.

An executor owns the arrays of one build, by name, for as long as it takes. A step is a function at the top level of a
module, ``step(arrays, *task)``: it sees all arrays, gets small arguments and returns small results.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...support.host_threads import HostThreads
from .arena import Arena, ArrayHandle
from .pool import WorkerPool
from .workspace import Workspace

Arrays = Mapping[str, NDArray[Any]]
Step = Callable[..., Any]
Task = tuple[Any, ...]


@contextmanager
def open_executor(pool: WorkerPool | None) -> Iterator[Executor]:
    """Open the executor of one build: the workers of a pool, or without one the calling process.

    A pool serves one build at a time; builds of other threads wait here.

    Raises
    ------
    PoolError
        The workers did not start, or one of them died.
    """
    if pool is None:
        yield CallingProcess()
        return
    with pool.hold() as workspace, Arena() as arena:
        executor = PoolExecutor(pool, workspace, arena)
        yield executor
        executor.release()


class Executor(ABC):
    """Some workers, and arrays that all of them see.

    Attributes
    ----------
    workers : int
    threads : HostThreads
        As many threads of the calling process, for arrays that the workers do not see: the mesh, and the result.
    arrays : dict of str to array
    """

    def __init__(self, workers: int, threads: HostThreads) -> None:
        self.workers = workers
        self.threads = threads
        self.arrays: dict[str, NDArray[Any]] = {}

    @abstractmethod
    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a new array of zeros, which outlives the build.

        Raises
        ------
        PoolError
            There is not enough memory to share.
        """

    @abstractmethod
    def borrow(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array with arbitrary contents; its memory may serve the next build.

        Raises
        ------
        PoolError
            There is not enough memory to share.
        """

    @abstractmethod
    def keep(self, name: str) -> NDArray[Any]:
        """Return a borrowed array, or a copy, that outlives the build."""

    @abstractmethod
    def share(self, name: str, array: NDArray[Any]) -> None:
        """Let all steps read an array that exists."""

    @abstractmethod
    def discard(self, *names: str) -> None:
        """Let go of created or shared arrays that no later step needs."""

    @abstractmethod
    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:
        """Return ``step(arrays, *task)`` for each task; tasks begin in the order given.

        Raises
        ------
        PoolError
            A step raised, or a worker died or fell silent.
        """

    @abstractmethod
    def run_on_each(self, step: Step, *task: Any) -> list[Any]:
        """Run a step once on every worker; return the results."""


class CallingProcess(Executor):
    """One worker: the calling process, in the calling thread."""

    def __init__(self) -> None:
        super().__init__(1, HostThreads(1))

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:  # noqa: D102
        self.arrays[name] = np.zeros(shape, dtype)
        return self.arrays[name]

    def borrow(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:  # noqa: D102
        self.arrays[name] = np.empty(shape, dtype)
        return self.arrays[name]

    def keep(self, name: str) -> NDArray[Any]:  # noqa: D102
        return self.arrays[name]

    def share(self, name: str, array: NDArray[Any]) -> None:  # noqa: D102
        # numba would compile every step once more for an array that is read-only or not contiguous.
        self.arrays[name] = np.require(array, requirements=["C", "W"])

    def discard(self, *names: str) -> None:  # noqa: D102
        for name in names:
            del self.arrays[name]

    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:  # noqa: D102
        return [step(self.arrays, *task) for task in tasks]

    def run_on_each(self, step: Step, *task: Any) -> list[Any]:  # noqa: D102
        return [step(self.arrays, *task)]


class PoolExecutor(Executor):
    """The workers of a pool, with shared memory for the arrays.

    Parameters
    ----------
    pool : WorkerPool
    workspace : Workspace
        Memory for borrowed arrays, which stays mapped in all processes between builds.
    arena : Arena
        Memory for all other arrays.
    """

    def __init__(self, pool: WorkerPool, workspace: Workspace, arena: Arena) -> None:
        super().__init__(pool.workers, pool.threads)
        self._pool = pool
        self._workspace = workspace
        self._arena = arena
        self._borrowed: dict[str, ArrayHandle] = {}
        self._owned: dict[str, ArrayHandle] = {}

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:  # noqa: D102
        self._owned[name], self.arrays[name] = self._arena.create(shape, dtype)
        return self.arrays[name]

    def borrow(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:  # noqa: D102
        self._borrowed[name], self.arrays[name] = self._workspace.take(name, shape, dtype)
        return self.arrays[name]

    def keep(self, name: str) -> NDArray[Any]:  # noqa: D102
        borrowed = self.arrays[name]
        copy = np.empty_like(borrowed)

        def copy_range(begin: int, end: int) -> None:
            copy[begin:end] = borrowed[begin:end]

        self.threads.for_ranges(len(copy), copy_range)
        return copy

    def share(self, name: str, array: NDArray[Any]) -> None:  # noqa: D102
        self.create(name, array.shape, array.dtype)[...] = array

    def discard(self, *names: str) -> None:  # noqa: D102
        for name in names:
            self._arena.free(self._owned.pop(name))
            del self.arrays[name]

    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:  # noqa: D102
        self._pool.attach(self._borrowed | self._owned)
        return self._pool.share_out(step, tasks)

    def run_on_each(self, step: Step, *task: Any) -> list[Any]:  # noqa: D102
        self._pool.attach(self._borrowed | self._owned)
        # The pool hands a task to each worker before it waits for a result.
        return self._pool.map(step, [task] * self.workers)

    def release(self) -> None:
        """Let the workers let go of all memory that the next build will not use."""
        if self._workspace.is_too_large:
            self._workspace.close()
            self._borrowed.clear()
        self._pool.attach(self._borrowed)

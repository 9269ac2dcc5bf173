"""Worker processes that build subtrees in shared memory: the report's form of a parallel build.

Owns the processes, and hands out tasks through pipes. `multiprocessing` spawns them: nothing is forked, since an OpenCL
driver may run threads. Must know nothing of meshes and trees.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from typing import Any

from numpy.typing import DTypeLike, NDArray

from ...errors import PoolError
from ...support.context_manager import ContextManager
from ...support.host_threads import HostThreads, usable_cores
from ..executor import Executor, Step, Task
from ..options import check_workers
from .shared_memory import ArrayHandle, SharedArray
from .worker import serve

# A worker that is not busy ends sooner, once it has started.
_STOP_PATIENCE_S = 2.0


class SubtreePool(ContextManager):
    """Worker processes that build subtrees, and serve many builds.

    Builds need none: without a pool they run in threads, as fast and with nothing to start. The processes start in the
    background at once, and import the main script, as all that `multiprocessing` spawns: create a pool under
    ``if __name__ == "__main__":``. Use the pool as a context manager.

    Parameters
    ----------
    workers : int, optional
        Number of processes; the number of usable processors without it.

    Raises
    ------
    ConfigError
        A number of workers below 1 or above 1024.
    PoolError
        The workers cannot start. From any use: a worker failed or died. The pool is closed then, and cannot be used
        again.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.make_shape("icosphere", triangles=30_000)
    >>> with clbvh.SubtreePool(workers=2) as pool:
    ...     bvh = clbvh.build(mesh, pool=pool)
    >>> bvh.nodes.tobytes() == clbvh.build(mesh).nodes.tobytes()
    True
    """

    def __init__(self, workers: int | None = None) -> None:
        check_workers(workers)
        self.workers = int(workers or usable_cores())
        self._owner = os.getpid()
        self._threads = HostThreads(self.workers)
        # Threads that use one pool take turns, also to close it.
        self._turn = threading.RLock()
        self._workers: list[_Worker] = []
        # Also called when the pool is garbage, and when the program ends.
        self._stop = weakref.finalize(self, _stop_all, self._workers, self._owner)
        for number in range(self.workers):
            self._workers.append(_Worker(number))

    def wait_ready(self) -> None:
        """Return when every worker has started.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.SubtreePool(workers=1) as pool:
        ...     pool.wait_ready()  # an error of a worker is raised here, not in the first build
        """
        with open_executor(self) as executor:
            executor.run_on_each(_do_nothing)

    def close(self) -> None:
        """End the workers, after the builds of other threads. In a forked child nothing happens."""
        if os.getpid() == self._owner:
            with self._turn:
                self._stop()
                self._threads.close()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(workers={self.workers}{'' if self._stop.alive else ', closed'})"


@contextmanager
def open_executor(pool: SubtreePool) -> Iterator[Executor]:
    """Open the executor of one build; builds of other threads wait."""
    if os.getpid() != pool._owner:
        raise PoolError(
            "the pool belongs to the process that this one was forked from: create another one, or build without"
        )
    with pool._turn:
        if not pool._stop.alive:
            raise PoolError("the pool is closed: create another one")
        with _PoolExecutor(pool._threads, pool._workers, pool._stop) as executor:
            yield executor


class _Worker:
    """One worker process, and the pipe to it."""

    def __init__(self, number: int) -> None:
        self._number = number
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs,), name=f"clbvh worker {number}", daemon=True)
        try:
            self.process.start()
        except OSError as error:
            raise PoolError(f"the worker processes do not start: {error}") from error
        finally:
            theirs.close()

    def run(self, handles: dict[str, ArrayHandle], step: Step, task: Task) -> Any:
        """Return the result of a step."""
        try:
            self.pipe.send_bytes(ForkingPickler.dumps((handles, step, task)))
            succeeded, value = self.pipe.recv()
        except (EOFError, OSError, TypeError):  # TypeError: another worker has failed, and its thread closes the pipe
            self.join()
            raise PoolError(
                f"worker {self._number} died (exit code {self.process.exitcode}); a negative code is the signal that "
                "killed it, and -9 often means that the system ran out of memory; 1 can mean that the script creates "
                "the pool outside of `if __name__ == '__main__':`"
            ) from None
        if not succeeded:
            raise PoolError(f"worker {self._number} failed:\n{value}")
        return value

    def join(self) -> None:
        """Wait for the end of the process, and kill it when patience ends."""
        self.process.join(_STOP_PATIENCE_S)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()


class _PoolExecutor(Executor):
    """The workers of a pool, with shared memory for the arrays."""

    def __init__(self, threads: HostThreads, workers: list[_Worker], stop: Any) -> None:
        super().__init__(threads)
        self._workers = workers
        self._stop = stop
        self._shared: dict[str, SharedArray] = {}
        self._errors: list[BaseException] = []  # the first one is the reason of the others

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a new array of zeros in shared memory."""
        self._shared[name] = SharedArray(shape, dtype)
        self.arrays[name] = self._shared[name].array
        return self.arrays[name]

    def share(self, name: str, array: NDArray[Any]) -> None:
        """Copy an array into shared memory."""
        self.create(name, array.shape, array.dtype)[...] = array

    def discard(self, *names: str) -> None:
        """Let go of arrays; workers do so with their next task."""
        for name in names:
            del self.arrays[name]
            self._shared.pop(name).close()

    def map(self, step: Step, tasks: Sequence[Task]) -> list[Any]:
        """Run tasks on whichever worker is free; one thread of this process waits for each worker."""
        idle: SimpleQueue[_Worker] = SimpleQueue()
        for worker in self._workers:
            idle.put(worker)

        def run_on_idle(*task: Any) -> Any:
            worker = idle.get()
            try:
                return self._run(worker, step, task)
            finally:
                idle.put(worker)

        return self._in_threads(run_on_idle, tasks)

    def run_on_each(self, step: Step, *task: Any) -> list[Any]:
        """Run a step once on every worker."""
        return self._in_threads(self._run, [(worker, step, task) for worker in self._workers])

    def close(self) -> None:
        """Give up all shared memory, here and in the workers."""
        self.discard(*list(self.arrays))
        if self._stop.alive:
            self.run_on_each(_do_nothing)

    def _in_threads(self, run: Callable[..., Any], argument_lists: Sequence[Task]) -> list[Any]:
        try:
            return self.threads.run(run, argument_lists)
        except PoolError:
            raise self._errors[0] from None

    def _run(self, worker: _Worker, step: Step, task: Task) -> Any:
        try:
            return worker.run({name: shared.handle for name, shared in self._shared.items()}, step, task)
        except BaseException as error:
            self._errors.append(error)
            # Others may still write to arrays that are about to go, and a pipe may hold half a message.
            for each in self._workers:
                each.process.kill()
            self._stop()
            raise


def _do_nothing(arrays: Any) -> None:
    """Start, or let go of arrays; a step."""


def _stop_all(workers: list[_Worker], owner: int) -> None:
    """End all workers; the end of a pool."""
    if os.getpid() == owner:
        for worker in workers:
            worker.pipe.close()  # it ends as soon as it is idle
        for worker in workers:
            worker.join()


def _disown_workers() -> None:
    """Forget all workers in a forked child, which would stop them when it ends; `multiprocessing` does so itself."""
    multiprocessing.process._children = set()  # type: ignore[attr-defined]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown_workers)

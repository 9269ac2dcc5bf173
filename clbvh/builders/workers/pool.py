"""Worker processes that outlive builds.

Hands out steps, collects results, notices death and silence; `start.py` starts the processes. Knows nothing of meshes
and trees: a step is any function, and a module that workers need in memory is given by its name.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from numbers import Integral
from types import TracebackType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, PoolError
from ...support.context_manager import ContextManager
from ...support.host_threads import HostThreads, usable_cores
from .arena import Arena, ArrayHandle
from .start import prepare_context, start_worker
from .worker import ATTACH, RUN, STOP, TAKE
from .workspace import Workspace

# Exit code of a worker that finds itself creating a pool while it imports the main script.
_UNGUARDED = 73

# A slip of the keyboard must not start a hundred thousand processes.
MAX_WORKERS = 1024

# A worker that needs longer than this for one step is taken for dead.
DEFAULT_TIMEOUT_S = 600.0

# How long a worker may take to stop: at the end, and after an error, when nobody waits for its result.
_STOP_PATIENCE_S = 2.0
_ERROR_PATIENCE_S = 0.2


# The counter of tasks has a cache line of its own; word 0 counts.
_COUNTER_WORDS = 8


class WorkerPool(ContextManager):
    """Worker processes that run steps on shared arrays.

    The workers start in the background at once, by a fork server (or by spawning where there is none): never by
    forking this process, whose OpenCL driver may run threads that a fork would cut off.

    Parameters
    ----------
    workers, timeout_s : optional
        See `SubtreePool`, which also says what is raised.
    preload : str, optional
        The name of a module that every worker imports before it counts as ready. The fork server imports it once, and
        all workers inherit it.
    """

    def __init__(
        self, workers: int | None = None, *, timeout_s: float = DEFAULT_TIMEOUT_S, preload: str | None = None
    ) -> None:
        if workers is not None and (isinstance(workers, bool) or not isinstance(workers, Integral)):
            raise ConfigError(f"workers must be a whole number, not {workers!r}")
        if workers is not None and not 1 <= workers <= MAX_WORKERS:
            raise ConfigError(f"workers must be 1 to {MAX_WORKERS}, not {workers}")
        # Written so that NaN fails.
        if not 0 < timeout_s < float("inf"):
            raise ConfigError(f"timeout_s must be a finite number above 0, not {timeout_s}")
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            # This is a worker that imports the main script, and the script has no guard: leave without a word.
            # The parent sees the exit code and raises the one error.
            os._exit(_UNGUARDED)
        self.workers = int(workers or usable_cores())
        self.start_ms = 0.0
        self._timeout_s = timeout_s
        self._preload = preload
        self._processes: list[Any] = []
        self._connections: list[Connection] = []
        self._start_error: BaseException | None = None
        self._unguarded = False
        self._closed = False
        self._process_id = os.getpid()
        # As many threads of this process as there are workers, for what workers do not see.
        self.threads = HostThreads(self.workers)
        self._workspace = Workspace()
        self._attached: dict[str, ArrayHandle] | None = None  # what all workers hold, once they have said so
        # The number of the next task, see `share_out`; the workers learn of it when they start.
        self._counter_memory = Arena()
        self._next_task: NDArray[np.int64] = np.zeros(1, np.int64)
        # Threads that use one pool take turns, also to close it. Reentrant: an error in a build closes the pool.
        self._one_build = threading.RLock()
        # Starting the fork server blocks until it has imported its modules, so a thread does it.
        self._starter = threading.Thread(target=self._start, name="clbvh-pool-start", daemon=True)
        self._starter.start()

    def wait_ready(self) -> None:
        """Return when every worker has started and loaded its compiled code.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.SubtreePool(workers=1) as pool:
        ...     pool.wait_ready()  # an error of a worker is raised here, not in the first build
        """
        self._check_process()
        self._starter.join(self._timeout_s)
        if self._starter.is_alive():
            # The fork server hangs: nobody waits for it again, nor for the thread that does.
            self._start_error = PoolError(f"the worker processes have not started for {self._timeout_s:g} s")
        if self._start_error is not None:
            self.close()
            raise self._start_error
        if self._closed:
            raise PoolError("the pool is closed: create another one")

    def attach(self, handles: Mapping[str, ArrayHandle]) -> None:
        """Let every worker hold exactly these shared arrays, by these names; it lets go of all others."""
        with self._turn(), _ClosedOnError(self):
            if handles == self._attached:
                return
            for worker in range(self.workers):
                self._send(worker, _pack(ATTACH, dict(handles)))
            self._wait_for_all()
            self._attached = dict(handles)

    @contextmanager
    def hold(self) -> Iterator[Workspace]:
        """Hold the workers for one build, for the length of a `with` block; builds of other threads wait.

        Yields the memory that stays mapped in all processes from one build to the next.

        Raises
        ------
        PoolError
            The workers did not start.
        """
        with self._turn():
            yield self._workspace

    def map(self, step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Run ``step(arrays, *task)`` for every task, on whichever worker is free, in the order given.

        Parameters
        ----------
        step : function
            A function at the top level of a module. Its first argument is the worker's attached arrays, by name.
        tasks : sequence of tuples

        Returns
        -------
        list
            The results, in the order of the tasks.

        Raises
        ------
        PoolError
            A step raised (the message holds the worker's traceback), or a worker died or fell silent.
        """
        results: list[Any] = [None] * len(tasks)
        idle = list(range(self.workers))
        busy: dict[int, int] = {}  # worker -> task
        next_task = 0
        with self._turn(), _ClosedOnError(self):
            while busy or next_task < len(tasks):
                while idle and next_task < len(tasks):
                    worker = idle.pop(0)
                    self._send(worker, _pack(RUN, step, tasks[next_task]))
                    busy[worker] = next_task
                    next_task += 1
                worker, result = self._receive(busy)
                results[busy.pop(worker)] = result
                idle.append(worker)
        return results

    def share_out(self, step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Do as `map` does, with one message to each worker: it takes the next task as soon as it is free.

        So tasks may be small. Any of them may come to any worker, and a worker may get none.

        Parameters
        ----------
        step, tasks
            As of `map`.

        Returns
        -------
        list
            The results, in the order of the tasks.

        Raises
        ------
        PoolError
            See `map`. A worker counts as silent when no task of any worker has begun for the whole timeout.
        """
        results: list[Any] = [None] * len(tasks)
        with self._turn(), _ClosedOnError(self):
            self._next_task[0] = 0
            message = _pack(TAKE, step, list(tasks))
            busy = dict.fromkeys(range(min(self.workers, len(tasks))))
            for worker in busy:
                self._send(worker, message)
            while busy:
                worker, numbered_results = self._receive(busy)
                del busy[worker]
                for number, result in numbered_results:
                    results[number] = result
        return results

    def close(self) -> None:
        """Stop the workers, after the builds of other threads have ended. Closing twice is allowed.

        In a forked child nothing happens: the workers are the parent's.

        Examples
        --------
        >>> import clbvh
        >>> pool = clbvh.SubtreePool(workers=1)
        >>> pool.close()
        """
        if self._process_id == os.getpid():
            with self._one_build:
                self._stop(_STOP_PATIENCE_S)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        if error is None and self._unguarded and self._start_error is not None:
            # Nothing in the block has used the workers, so nothing has raised it.
            raise self._start_error

    def __repr__(self) -> str:
        return f"{type(self).__name__}(workers={self.workers}{', closed' if self._closed else ''})"

    def _check_process(self) -> None:
        """Raise `PoolError` in a forked child, whose messages would mix with the parent's."""
        if self._process_id != os.getpid():
            raise PoolError(
                "the pool belongs to the process that this one was forked from: create another one, or build without"
            )

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Keep other threads from the workers, which are ready, for the length of a `with` block."""
        self._check_process()
        with self._one_build:
            self.wait_ready()
            yield

    def _start(self) -> None:
        """Start all workers and wait until each says that it is ready; keep an error for `wait_ready`."""
        begin = time.perf_counter()
        try:
            context, folder = prepare_context(self._preload)
            counter, self._next_task = self._counter_memory.create((_COUNTER_WORDS,), np.int64)
            for number in range(self.workers):
                process, connection = start_worker(context, number, folder, self._preload, counter, self._timeout_s)
                if self._closed:
                    # The fork server hung, and nobody waits any more.
                    process.kill()
                    process.join()
                    return
                self._processes.append(process)
                self._connections.append(connection)
            self._wait_for_all()
        except PoolError as error:
            self._start_error = self._start_error or error
        except Exception as error:
            if self._start_error is None:
                self._start_error = PoolError(f"the worker processes do not start: {error}")
                self._start_error.__cause__ = error
        self.start_ms = (time.perf_counter() - begin) * 1e3

    def _stop(self, patience_s: float) -> None:
        """Ask the workers to stop, and kill those that are still busy when patience ends."""
        if self._closed:
            return
        if self._start_error is None:
            self._starter.join(self._timeout_s)
        self._closed = True
        for connection in self._connections:
            with suppress(OSError):  # it may be gone already
                connection.send_bytes(_pack(STOP))
            connection.close()
        deadline = time.monotonic() + patience_s
        for process in self._processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self._workspace.close()
        self._counter_memory.close()
        self.threads.close()

    def _wait_for_all(self) -> None:
        """Return when every worker has answered."""
        silent = dict.fromkeys(range(self.workers))
        while silent:
            worker, _ = self._receive(silent)
            del silent[worker]

    def _send(self, worker: int, message: bytes) -> None:
        """Send a message to an idle worker."""
        try:
            self._connections[worker].send_bytes(message)
        except BlockingIOError:
            raise self._explain_silence([worker]) from None
        except OSError:
            raise self._explain_death(worker) from None

    def _receive(self, workers: Mapping[int, Any]) -> tuple[int, Any]:
        """Return the next worker that answers, of these, and its result."""
        connections = {self._connections[worker]: worker for worker in workers}
        # Whoever takes tasks from the counter is busy, not silent.
        ready: list[Any] = []
        begun = -1
        while not ready and begun != self._next_task[0]:
            begun = int(self._next_task[0])
            ready = wait(list(connections), timeout=self._timeout_s)
        if not ready:
            raise self._explain_silence(workers)
        connection = cast(Connection, ready[0])
        worker = connections[connection]
        try:
            succeeded, value = connection.recv()
        except BlockingIOError:
            raise self._explain_silence([worker]) from None
        except (EOFError, OSError):
            raise self._explain_death(worker) from None
        if not succeeded:
            raise PoolError(f"worker {worker} failed:\n{value}")
        return worker, value

    def _explain_silence(self, workers: Iterable[int]) -> PoolError:
        """Return the error for workers that do not answer."""
        numbers = ", ".join(str(worker) for worker in workers)
        return PoolError(f"worker {numbers} has not answered for {self._timeout_s:g} s and was stopped")

    def _explain_death(self, worker: int) -> PoolError:
        """Return the error for a worker whose pipe broke."""
        process = self._processes[worker]
        process.join(_STOP_PATIENCE_S)
        if process.exitcode == _UNGUARDED:
            self._unguarded = True
            return PoolError(
                f"this script creates a {type(self).__name__} while its workers import it: put the code that runs "
                'under if __name__ == "__main__":'
            )
        return PoolError(
            f"worker {worker} died (exit code {process.exitcode}); a negative code is the signal that killed it, "
            "and -9 often means that the system ran out of memory"
        )


def _pack(*message: Any) -> bytes:
    """Return a message as workers read it."""
    return bytes(ForkingPickler.dumps(message))


class _ClosedOnError:
    """Close the pool when the block fails: its workers may still write to arrays that are about to go."""

    def __init__(self, pool: WorkerPool) -> None:
        self._pool = pool

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: Any, trace: Any) -> None:
        if kind is not None:
            self._pool._stop(_ERROR_PATIENCE_S)

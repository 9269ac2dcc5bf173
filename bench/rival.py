"""An engine in a process of its own: in one process, engines disturb each other by the threads they leave running."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

Tasks = dict[str, Callable[[], Any]]

# A task that takes longer hangs.
PATIENCE_S = 1200.0


class Rival:
    """A process that is idle while others are measured; a context manager.

    Parameters
    ----------
    set_up : function
        Of a module; called there with the arguments, it returns tasks by name.
    *arguments
        Are pickled.
    """

    def __init__(self, set_up: Callable[..., Tasks], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, set_up, arguments))
        self._process.start()
        theirs.close()
        self._receive()

    def measure_ms(self, task: str) -> float:
        """Do a task, and return how long it took there."""
        return self._ask(task)[0]

    def ask(self, task: str) -> Any:
        """Do a task, and return its result."""
        return self._ask(task)[1]

    def __enter__(self) -> Rival:
        return self

    def __exit__(self, *error: object) -> None:
        self._connection.close()
        self._process.join(10)
        self._process.kill()

    def _ask(self, task: str) -> tuple[float, Any]:
        self._connection.send(task)
        return self._receive()

    def _receive(self) -> Any:
        if not self._connection.poll(PATIENCE_S):
            self._process.kill()
            raise TimeoutError(f"no answer for {PATIENCE_S:g} s")
        failure, answer = self._connection.recv()
        if failure:
            raise RuntimeError(failure)
        return answer


def _serve(connection: Connection, set_up: Callable[..., Tasks], arguments: tuple[Any, ...]) -> None:
    """Do tasks until the other end is closed."""
    try:
        tasks = set_up(*arguments)
        connection.send((None, None))
        while True:
            task = tasks[connection.recv()]
            begin = time.perf_counter()
            result = task()
            connection.send((None, ((time.perf_counter() - begin) * 1e3, result)))
    except EOFError:
        pass
    except Exception:
        connection.send((traceback.format_exc(), None))

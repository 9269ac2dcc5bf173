"""Tasks of an engine in a process of its own, timed there."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from clbvh.study import rival

Tasks = dict[str, Callable[[], Any]]


class Rival(rival.Rival):
    """A process that is idle while others are measured; a context manager.

    Parameters
    ----------
    set_up : function
        Of a module; called there with the arguments, it returns tasks by name.
    *arguments
        Are pickled.
    """

    def __init__(self, set_up: Callable[..., Tasks], *arguments: Any) -> None:
        super().__init__(set_up.__name__, _TimedTasks, set_up, *arguments)

    def measure_ms(self, task: str) -> float:
        """Do a task, and return how long it took there."""
        return super().ask(task)[0]

    def ask(self, task: str) -> Any:
        """Do a task, and return its result."""
        return super().ask(task)[1]


class _TimedTasks:
    def __init__(self, set_up: Callable[..., Tasks], *arguments: Any) -> None:
        self._tasks = set_up(*arguments)

    def answer(self, question: str) -> tuple[float, Any]:
        task = self._tasks[question]
        begin = time.perf_counter()
        result = task()
        return (time.perf_counter() - begin) * 1e3, result

    def close(self) -> None:
        """Leave all to the end of the process."""

"""Compiled loops in several threads of this process.

For steps that read or write private memory, the mesh and the finished tree, which other processes cannot see: numba's
loops let go of Python's lock while they run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_Result = TypeVar("_Result")


def run_in_threads(function: Callable[..., _Result], tasks: Sequence[tuple[object, ...]]) -> list[_Result]:
    """Return ``function(*task)`` for each task, in their order; every task has a thread of its own."""
    if len(tasks) == 1:
        return [function(*tasks[0])]
    with ThreadPoolExecutor(len(tasks)) as executor:
        return list(executor.map(lambda task: function(*task), tasks))

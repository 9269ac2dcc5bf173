"""Who does the steps of a build: the calling process, or the workers of a pool. The build does not know which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..arena import Arena, ArrayHandle
from ..pool import SubtreePool


class Crew(Protocol):
    """Arrays by name, and somebody who runs steps on them; a context manager that lets go of the arrays."""

    workers: int

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return a new array that all steps see under this name."""

    def share(self, name: str, array: NDArray[Any]) -> None:
        """Let all steps see an array, to read, under this name."""

    def discard(self, *names: str) -> None:
        """Let go of arrays that no later step needs."""

    def map(self, step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Return ``step(arrays, *task)`` for each task."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


# Messages per worker and round, at most.
_BATCHES_PER_WORKER = 32


def run_batch(arrays: Mapping[str, NDArray[Any]], step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Any:
    """Run a step for several tasks; the step that every message asks for."""
    return [step(arrays, *task) for task in tasks]


def run_on_each(crew: Crew, step: Callable[..., Any], *task: Any) -> list[Any]:
    """Run one step once on every worker: a pool hands a task to each before it waits for an answer."""
    return crew.map(step, [task] * crew.workers)


class Caller:
    """The calling process."""

    workers = 1

    def __init__(self) -> None:
        self._arrays: dict[str, NDArray[Any]] = {}

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """See `Crew`."""
        return self._arrays.setdefault(name, np.zeros(shape, dtype))

    def share(self, name: str, array: NDArray[Any]) -> None:
        """See `Crew`; copies only an array that compiled code would be compiled for once more."""
        self._arrays[name] = np.require(array, requirements=["C", "W"])

    def discard(self, *names: str) -> None:
        """See `Crew`."""
        for name in names:
            del self._arrays[name]

    def map(self, step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """See `Crew`."""
        return run_batch(self._arrays, step, tasks)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._arrays.clear()


class Workers:
    """The workers of a pool, with shared memory for the arrays."""

    def __init__(self, pool: SubtreePool) -> None:
        self.workers = pool.workers
        self._pool = pool
        self._arena = Arena()
        self._handles: dict[str, ArrayHandle] = {}
        self._attached: dict[str, ArrayHandle] | None = None

    def create(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """See `Crew`."""
        self._handles[name], array = self._arena.create(shape, dtype)
        return array

    def share(self, name: str, array: NDArray[Any]) -> None:
        """See `Crew`; copies the array."""
        self._handles[name] = self._arena.share(array)

    def discard(self, *names: str) -> None:
        """See `Crew`."""
        for name in names:
            self._arena.free(self._handles.pop(name))

    def map(self, step: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """See `Crew`."""
        if self._attached != self._handles:
            self._pool.attach(self._handles)
            self._attached = dict(self._handles)
        # Many small tasks travel together, so that messages do not outweigh the work.
        batch_count = min(len(tasks), self.workers * _BATCHES_PER_WORKER)
        batches = [(step, tasks[number::batch_count]) for number in range(batch_count)]
        results: list[Any] = [None] * len(tasks)
        for number, answers in enumerate(self._pool.map(run_batch, batches)):
            results[number::batch_count] = answers
        return results

    def __enter__(self) -> Self:
        self._arena.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._pool.attach({})
        self._arena.__exit__(kind, error, trace)

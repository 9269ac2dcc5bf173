"""Who builds: the calling process alone, or together with the workers of a pool. A build does not know which.

A crew has the arrays that every build of ours needs, for as long as it takes; the rungs of the study, which differ in
their arrays, have `ladder.crew`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..host_threads import HostThreads
from ..simd import LANES
from .pool import SubtreePool
from .workspace import Shapes


@dataclass(frozen=True, eq=False)
class Crew:
    """Some workers, and arrays that all of them see.

    Attributes
    ----------
    workers : int
    arrays : mapping of str to array
        For n primitives ``records``, (2, n, 8) float32, and ``prim_ids``, (n,) int32; with arbitrary contents at first.
    map : function
        ``map(step, tasks)`` returns ``step(arrays, *task)`` for each task, in the order given.
    threads : HostThreads
        As many threads of the calling process, for what the workers do not see: the mesh, and the result.
    """

    workers: int
    arrays: Mapping[str, NDArray[Any]]
    map: Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
    threads: HostThreads


@contextmanager
def gather(pool: SubtreePool | None, prim_count: int) -> Iterator[Crew]:
    """Give a crew the arrays that it needs for one build; without a pool the calling process is the crew.

    Raises
    ------
    PoolError
        A worker failed or died, or there is not enough memory to share.
    """
    shapes: Shapes = {"records": ((2, prim_count, LANES), np.float32), "prim_ids": ((prim_count,), np.int32)}
    if pool is not None:
        with pool.lend(shapes) as arrays:
            yield Crew(pool.workers, arrays, pool.map, pool.threads)
        return
    arrays = {name: np.empty(shape, dtype) for name, (shape, dtype) in shapes.items()}
    yield Crew(1, arrays, lambda step, tasks: [step(arrays, *task) for task in tasks], HostThreads(1))

"""The working memory of a pool, kept from one build to the next.

Shared memory that is new costs a page fault for every 4 KiB in every process that touches it, which took a third of the
time of a build: 871,306 triangles, two workers.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...support.context_manager import ContextManager
from .arena import Arena, ArrayHandle

# More than this is given back after a build: enough for 15 million triangles.
_KEPT_BYTES = 2**30


@dataclass(frozen=True, eq=False)
class _Block:
    """Memory of one name; it may be larger than the array that lies in it."""

    arena: Arena
    handle: ArrayHandle
    memory: NDArray[np.uint8]


class Workspace(ContextManager):
    """Owner of shared memory that is used again, by name."""

    def __init__(self) -> None:
        self._blocks: dict[str, _Block] = {}

    def take(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> tuple[ArrayHandle, NDArray[Any]]:
        """Return an array with arbitrary contents, and the handle that attaches workers to it.

        It lies in the memory of the last array of this name, if that is large enough.

        Raises
        ------
        PoolError
            See `Arena.create`.
        """
        block = self._find_block(name, prod(shape) * np.dtype(dtype).itemsize)
        handle = block.handle.reshape(shape, dtype)
        return handle, handle.view(block.memory)

    @property
    def is_too_large(self) -> bool:
        """Whether it holds more than should be kept between builds."""
        return sum(block.memory.nbytes for block in self._blocks.values()) > _KEPT_BYTES

    def close(self) -> None:
        """Give all memory back. Closing twice is allowed."""
        while self._blocks:
            self._blocks.popitem()[1].arena.close()

    def _find_block(self, name: str, size: int) -> _Block:
        block = self._blocks.get(name)
        if block is not None and block.memory.nbytes >= size:
            return block
        if block is not None:
            self._blocks.pop(name).arena.close()
        # An arena of its own: it knows how much memory is free at this moment.
        arena = Arena()
        handle, memory = arena.create((size,), np.uint8)
        self._blocks[name] = _Block(arena, handle, memory)
        return self._blocks[name]

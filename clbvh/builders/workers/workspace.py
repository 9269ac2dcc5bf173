"""The working memory of a pool, kept from one build to the next.

Shared memory that is new costs a page fault for every 4 KiB in every process that touches it, which took a third of the
time of a build: 871,306 triangles, two workers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..closing import Closing
from .arena import Arena, ArrayHandle

# More than this is given back after a build: enough for 15 million triangles.
_KEPT_BYTES = 2**30

# Arrays by name: shape and dtype.
Shapes = Mapping[str, tuple[tuple[int, ...], DTypeLike]]


@dataclass(frozen=True, eq=False)
class _Room:
    """Memory for one array; it may be larger than the array at hand."""

    arena: Arena
    handle: ArrayHandle
    memory: NDArray[np.uint8]


class Workspace(Closing):
    """Owner of arrays that are taken again and again, by name."""

    def __init__(self) -> None:
        self._rooms: dict[str, _Room] = {}

    def take(self, shapes: Shapes) -> tuple[dict[str, NDArray[Any]], dict[str, ArrayHandle]]:
        """Return arrays of these shapes, with whatever they hold, and the handles that attach workers to them.

        Raises
        ------
        PoolError
            See `Arena.create`.
        """
        arrays, handles = {}, {}
        for name, (shape, dtype) in shapes.items():
            room = self._find_room(name, prod(shape) * np.dtype(dtype).itemsize)
            handles[name] = room.handle.reshape(shape, dtype)
            arrays[name] = handles[name].view(room.memory)
        return arrays, handles

    @property
    def is_too_large(self) -> bool:
        """Whether it holds more than should be kept between builds."""
        return sum(room.memory.nbytes for room in self._rooms.values()) > _KEPT_BYTES

    def close(self) -> None:
        """Give all memory back. Closing twice is allowed."""
        while self._rooms:
            self._rooms.popitem()[1].arena.close()

    def _find_room(self, name: str, size: int) -> _Room:
        room = self._rooms.get(name)
        if room is not None and room.memory.nbytes >= size:
            return room
        if room is not None:
            self._rooms.pop(name).arena.close()
        # An arena of its own: it knows how much memory is free at this moment.
        arena = Arena()
        handle, memory = arena.create((size,), np.uint8)
        self._rooms[name] = _Room(arena, handle, memory)
        return self._rooms[name]

"""Rows of a picture that are on the device together, and what painters do there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..trace.running_calls import CallMemory


class Band(NamedTuple):
    """Rows of a picture that are on the device together.

    Attributes
    ----------
    memory : CallMemory
        Of the picture.
    width, height : int
        Of the whole picture, in pixels.
    first_row, row_count : int
    report : function
        Called with the share of the band's samples that are done; it raises where the picture is to end early.
    view, colours, hits : buffer
        The arguments of those names, see cl/kernels/render.cl.
    """

    memory: CallMemory
    width: int
    height: int
    first_row: int
    row_count: int
    report: Callable[[float], None]
    view: Any
    colours: Any
    hits: Any

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the band."""
        return self.width, self.row_count

    @property
    def rows(self) -> dict[str, Any]:
        """The arguments of every kernel that works on a band."""
        return {"view": self.view, "first_row": np.int32(self.first_row), "row_count": np.int32(self.row_count)}

    def run(self, kernel: Any, size: tuple[int, int], tile: tuple[int, int], **arguments: Any) -> None:
        """Run a kernel in the queue of the picture."""
        self.memory.session.run(kernel, size, tile, **arguments)

    def take(self, name: str, size: int) -> Any:
        """Return a buffer of at least `size` bytes."""
        return self.memory.buffer(name, for_mapping=False).take(size)

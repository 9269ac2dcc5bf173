"""A wide tree as compiled functions take it. Knows nothing of numba, so that it costs nothing to import."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray


class WideArrays(NamedTuple):
    """A tree in the layout `bvh4` or `bvh8` as 4-byte lanes: floats, and the same as integers.

    Attributes
    ----------
    nodes : (N * 7 * width,) float32
    node_ints : (N * 7 * width,) int32
    blocks : (G * 10 * width,) float32
    block_ints : (G * 10 * width,) int32
    slots : tuple of int
        0 to width - 1: the type tells the compiler the width, so that loops over children become vector instructions.
    stack_size : int
    """

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    blocks: NDArray[np.float32]
    block_ints: NDArray[np.int32]
    slots: tuple[int, ...]
    stack_size: int

    @classmethod
    def of(cls, nodes: NDArray[Any], blocks: NDArray[Any], width: int, stack_size: int) -> Self:
        """Return views of `structs.WIDE_NODES[width]` and `structs.TRIANGLE_BLOCKS[width]`, or of their bytes."""
        node_lanes, block_lanes = (items.view(np.float32).reshape(-1) for items in (nodes, blocks))
        for lanes in (node_lanes, block_lanes):
            lanes.flags.writeable = False
        return cls(
            node_lanes, node_lanes.view(np.int32), block_lanes, block_lanes.view(np.int32), tuple(range(width)),
            stack_size,
        )  # fmt: skip

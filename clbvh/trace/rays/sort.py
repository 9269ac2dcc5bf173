"""Scattered rays in a coherent order: neighbours enter and leave the tree's box in the same cells.

Rays in random order wait for memory at nearly every node; rays of neighbouring work-items share what is in the cache.
After Moon et al., "Cache-oblivious ray reordering" (2010).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from ...support.counting_sort import LAST_KEY, order_by_keys
from ...support.host_threads import HostThreads
from .batch import RayBatch, TreeBox
from .cells import BLOCK, CELLS_PER_RAY, find_cells, make_block, make_grid, meets_box


def sort_rays(batch: RayBatch, begin: int, end: int, box: TreeBox, threads: HostThreads) -> NDArray[np.int32]:
    """Return the order in which to cast rays `begin` to `end`, counted from `begin`; the rays need not be valid."""
    grid = make_grid(box)

    def make_keys(first: int, last: int, keys: NDArray[np.int32]) -> None:
        _make_keys(batch.part(begin + first, begin + last), grid, make_block(), keys)

    return order_by_keys(end - begin, threads, make_keys)


@compiled(error_model="numpy")
def _make_keys(rays, grid, block, keys):
    """Write the keys of rays: a Morton code of six cell numbers, and the last key for rays that miss the box."""
    cells = block.cells
    for first in range(0, len(keys), BLOCK):
        count = min(BLOCK, len(keys) - first)
        find_cells(rays, grid, first, count, block)
        for ray in range(BLOCK):
            key = np.int32(0)
            for axis in range(CELLS_PER_RAY):
                # The bits of a cell number with five zeros between them, so that six numbers interleave.
                cell = cells[axis, ray]
                key |= ((cell & 1) | (cell & 2) << 5 | (cell & 4) << 10 | (cell & 8) << 15) << axis
            cells[0, ray] = key if meets_box(block, ray) else np.int32(LAST_KEY)
        for ray in range(count):
            keys[first + ray] = cells[0, ray]

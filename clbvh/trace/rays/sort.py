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
from .cells import CELLS_PER_AXIS, FINE_CELLS_PER_AXIS, find_cell, find_interval, flatten_rays, make_grid

_LAST_KEY = np.int32(LAST_KEY)


def sort_rays(
    batch: RayBatch, begin: int, end: int, box: TreeBox, threads: HostThreads, *, is_pencil: bool = False
) -> NDArray[np.int32]:
    """Return the order in which to cast rays `begin` to `end`, counted from `begin`; the rays need not be valid.

    The rays of a pencil are told apart by where they leave the box alone, in finer cells.
    """
    grid = make_grid(box, FINE_CELLS_PER_AXIS if is_pencil else CELLS_PER_AXIS)
    write_keys = _write_exit_keys if is_pencil else _write_keys

    def make_keys(first: int, last: int, keys: NDArray[np.int32]) -> None:
        rays = batch.part(begin + first, begin + last)
        for part, flat in flatten_rays(rays, last - first):
            write_keys(flat, grid, keys[part : part + len(flat.t_min)])

    return order_by_keys(end - begin, threads, make_keys)


@compiled(error_model="numpy")
def _write_keys(rays, grid, keys):
    """Write the keys of rays: a Morton code of six cell numbers, and the last key for rays that miss the box."""
    for ray in range(len(keys)):
        origin, direction, t_near, t_far = find_interval(rays, grid, ray)
        key = np.int32(0)
        for axis in range(3):
            entry = find_cell(origin, direction, t_near, grid, axis)
            key |= _spread_by_six(entry) << axis
            key |= _spread_by_six(find_cell(origin, direction, t_far, grid, axis)) << axis + 3
        keys[ray] = _key_or_last(key, t_near, t_far)


@compiled(error_model="numpy")
def _write_exit_keys(rays, grid, keys):
    """Write the keys of a pencil's rays: a Morton code of three cell numbers, and the last key as above."""
    for ray in range(len(keys)):
        origin, direction, t_near, t_far = find_interval(rays, grid, ray)
        key = np.int32(0)
        for axis in range(3):
            key |= _spread_by_three(find_cell(origin, direction, t_far, grid, axis)) << axis
        keys[ray] = _key_or_last(key, t_near, t_far)


@compiled
def _key_or_last(key, t_near, t_far):
    return _LAST_KEY if t_near > t_far else key


@compiled
def _spread_by_six(cell):
    """Return the 4 bits of a cell number with five zeros between them, so that six numbers interleave."""
    return (cell & 1) | (cell & 2) << 5 | (cell & 4) << 10 | (cell & 8) << 15


@compiled
def _spread_by_three(cell):
    """Return the 8 bits of a cell number with two zeros between them, so that three numbers interleave."""
    cell = (cell | cell << 8) & 0x00F00F
    cell = (cell | cell << 4) & 0x0C30C3
    return (cell | cell << 2) & 0x249249

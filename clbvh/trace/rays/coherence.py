"""Coherence: whether rays that follow each other take similar ways through the tree, judged by a sample."""

from __future__ import annotations

import numpy as np

from ...support.compiled import compiled
from .batch import RayBatch, TreeBox
from .cells import BLOCK, CELLS_PER_RAY, find_cells, make_block, make_grid, meets_box

# Pairs of neighbours in a sample. Their distance in the batch follows the golden ratio, so that it is no whole number
# of a picture's rows.
_SAMPLES = 128
_GOLDEN = (5**0.5 - 1) / 2

# Rays are scattered if this share of pairs lie more than a cell apart: few pairs of a picture's rays do, and most
# pairs of rays in random order.
_SCATTERED_SHARE = 0.25


def is_scattered(batch: RayBatch, begin: int, end: int, box: TreeBox) -> bool:
    """Say whether rays `begin` to `end` take different ways; the rays need not be valid."""
    firsts = begin + (np.arange(_SAMPLES) * _GOLDEN % 1.0 * (end - begin - 1)).astype(np.int64)
    pairs = batch.take(np.stack((firsts, firsts + 1), axis=1).reshape(-1)).part(0, 2 * _SAMPLES)
    entries, exits, far_entries = _measure_apart(pairs, 2 * _SAMPLES, make_grid(box), make_block())
    # Rays that leave a surface in all directions, point after point, share the nodes around it: sorting them gains
    # nothing. Rays from one eye inside the box all enter it in one cell, in any order.
    return bool(entries >= _SCATTERED_SHARE or (exits >= _SCATTERED_SHARE and far_entries < _SCATTERED_SHARE))


@compiled(error_model="numpy")
def _measure_apart(pairs, ray_count, grid, block):
    """Return shares of the pairs of rays that are more than a cell apart, of those that meet the box.

    Where the rays of a pair enter it, where they leave it, and where rays of different pairs enter it.
    """
    cells, meets = np.empty((ray_count, CELLS_PER_RAY), np.int32), np.empty(ray_count, np.bool_)
    for first in range(0, ray_count, BLOCK):
        find_cells(pairs, grid, first, BLOCK, block)
        for ray in range(BLOCK):
            meets[first + ray] = meets_box(block, ray)
            for axis in range(CELLS_PER_RAY):
                cells[first + ray, axis] = block.cells[axis, ray]
    considered, entries, exits, far_entries = 0, 0, 0, 0
    for ray in range(0, ray_count, 2):
        if not (meets[ray] or meets[ray + 1]):
            continue
        considered += 1
        is_alone = meets[ray] != meets[ray + 1]
        entries += is_alone or _are_apart(cells, ray, ray + 1, 0)
        exits += is_alone or _are_apart(cells, ray, ray + 1, 3)
        far_entries += _are_apart(cells, ray, (ray + ray_count // 2) % ray_count, 0)
    return entries / max(considered, 1), exits / max(considered, 1), far_entries / max(considered, 1)


@compiled
def _are_apart(cells, one, other, first_axis):
    """Say whether the cells of two rays neither are the same nor touch: entries from axis 0, exits from axis 3."""
    farthest = 0
    for axis in range(first_axis, first_axis + 3):
        farthest = max(farthest, abs(cells[one, axis] - cells[other, axis]))
    return farthest > 1

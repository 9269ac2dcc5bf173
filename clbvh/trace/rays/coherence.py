"""Coherence: whether rays that follow each other take similar ways through the tree, judged by a sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from .batch import RayBatch, TreeBox
from .cells import FINE_CELLS_PER_AXIS, find_cell, find_interval, flatten_rays, make_grid
from .ray_rows import RayRows

# Cells of a ray: of its entry along x, y and z, then of its exit.
_CELLS_PER_RAY = 6

# Pairs of neighbours in a sample.
_SAMPLES = 128

# The distance of samples in the batch follows the golden ratio, so that it is no whole number of a picture's rows.
_GOLDEN = (5**0.5 - 1) / 2

# Rays are scattered if this share of pairs lie more than a cell apart: few pairs of a picture's rays do, and most
# pairs of rays in random order.
_SCATTERED_SHARE = 0.25

# Rays of a pencil begin this close together, in half sizes of the box, or have directions that differ by no more: half
# a cell of the keys by which they are sorted.
_PENCIL_SHARE = 1 / FINE_CELLS_PER_AXIS


def is_scattered(batch: RayBatch, begin: int, end: int, box: TreeBox) -> bool:
    """Say whether rays `begin` to `end` take different ways; the rays need not be valid."""
    ((_, flat),) = flatten_rays(_sample_pairs(batch, begin, end), 2 * _SAMPLES)
    entries, exits, far_entries = _measure_apart(flat, 2 * _SAMPLES, make_grid(box))
    # Rays that leave a surface in all directions, point after point, share the nodes around it: sorting them gains
    # nothing. Rays from one eye inside the box all enter it in one cell, in any order.
    return bool(entries >= _SCATTERED_SHARE or (exits >= _SCATTERED_SHARE and far_entries < _SCATTERED_SHARE))


def is_pencil(batch: RayBatch, begin: int, end: int, box: TreeBox) -> bool:
    """Say whether rays `begin` to `end` have one origin or one direction, so that where they go tells all of them.

    Shuffled rays of a camera are such a pencil. The rays need not be valid.
    """
    rays = _sample_pairs(batch, begin, end)
    with np.errstate(all="ignore"):
        directions = rays.directions / np.linalg.norm(rays.directions, axis=1, keepdims=True)
        spread = np.ptp(rays.origins, axis=0).max() * box.scale
        turn = np.ptp(directions, axis=0).max()
    # Written so that NaN is none.
    return bool(spread <= _PENCIL_SHARE * box.half.max() or turn <= _PENCIL_SHARE)


def spread_samples(begin: int, end: int, count: int) -> NDArray[np.int64]:
    """Return (count,) int64: indices all over the range from `begin` to `end`, which is not empty."""
    return begin + (np.arange(count) * _GOLDEN % 1.0 * (end - begin)).astype(np.int64)


def _sample_pairs(batch: RayBatch, begin: int, end: int) -> RayRows:
    """Return neighbours among rays `begin` to `end`, a pair after the other."""
    firsts = spread_samples(begin, end - 1, _SAMPLES)
    return batch.take(np.stack((firsts, firsts + 1), axis=1).reshape(-1)).part(0, 2 * _SAMPLES)


@compiled(error_model="numpy")
def _measure_apart(pairs, ray_count, grid):
    """Return shares of the pairs of rays that are more than a cell apart, of those that meet the box.

    Where the rays of a pair enter it, where they leave it, and where rays of different pairs enter it.
    """
    cells, meets = np.empty((ray_count, _CELLS_PER_RAY), np.int32), np.empty(ray_count, np.bool_)
    for ray in range(ray_count):
        origin, direction, t_near, t_far = find_interval(pairs, grid, ray)
        meets[ray] = not t_near > t_far
        for axis in range(3):
            cells[ray, axis] = find_cell(origin, direction, t_near, grid, axis)
            cells[ray, 3 + axis] = find_cell(origin, direction, t_far, grid, axis)
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

"""The order in which rays are cast: whether they are a picture, or coherent, and if not, an order by cells of a grid.

Rays that follow each other in a picture take similar ways through the tree. Scattered rays wait for memory at nearly
every node; sorted by the grid cells where they enter and leave the tree's box, neighbours share what is in the cache
(Moon et al., "Cache-oblivious ray reordering", 2010).

Cells are found in float32: those of rays from very far, or with directions of a length beyond float32, are wrong, which
costs locality and nothing else.

The neighbours of a picture's ray in the rows above and below are as close as those in its own row. A flat array of rays
does not say how long its rows are, but a walk along it leads away from a ray and comes back to it one row later. A
scan all around, of which no row has an end, is a picture as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ..world.tree_box import TreeBox
from .batch import RayBatch

# Cells along each axis of the box where six numbers make a key, those of the entry and of the exit: 4 bits of it.
CELLS_PER_AXIS = 16

# Where the three numbers of the exit make a key: 8 bits of it.
FINE_CELLS_PER_AXIS = 256

# A box that is thinner along an axis has one cell there: the number of cells to a unit has to fit float32.
_THINNEST = np.float32(2.0**-100)

_LOOPS, _PICTURES = Loops("rays/order"), Loops("rays/picture")


def make_grid(box: TreeBox, cells_per_axis: int = CELLS_PER_AXIS) -> NDArray[np.float64]:
    """Return the grid over a box, as cl/host/rays/order.cl reads it.

    Its numbers are the centre and the local units in one unit of the file, then float32 in local units: half the size
    along each axis, the cells to a unit, and the number of the last cell.
    """
    half = box.half.astype(np.float32)
    cells_per_unit = np.float32(0.5 * cells_per_axis) / np.maximum(half, _THINNEST)
    return np.array([*box.centre, box.scale, *half, *cells_per_unit, cells_per_axis - 1], np.float64)


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
    shares = np.empty(3)
    _LOOPS.measure_apart(_sample_pairs(batch, begin, end).addresses, 0, make_grid(box), 2 * _SAMPLES, shares)
    entries, exits, far_entries = shares
    # Rays that leave a surface in all directions, point after point, share the nodes around it: sorting them gains
    # nothing. Rays from one eye inside the box all enter it in one cell, in any order.
    return bool(entries >= _SCATTERED_SHARE or (exits >= _SCATTERED_SHARE and far_entries < _SCATTERED_SHARE))


def is_pencil(batch: RayBatch, begin: int, end: int, box: TreeBox) -> bool:
    """Say whether rays `begin` to `end` have one origin or one direction, so that where they go tells all of them.

    Shuffled rays of a camera are such a pencil. The rays need not be valid.
    """
    origins, directions, *_ = _sample_pairs(batch, begin, end).arrays
    with np.errstate(all="ignore"):
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        spread = np.ptp(origins, axis=0).max() * box.scale
        turn = np.ptp(directions, axis=0).max()
    # Written so that NaN is none.
    return bool(spread <= _PENCIL_SHARE * box.half.max() or turn <= _PENCIL_SHARE)


def spread_samples(begin: int, end: int, count: int) -> NDArray[np.int64]:
    """Return (count,) int64: indices all over the range from `begin` to `end`, which is not empty."""
    return begin + (np.arange(count) * _GOLDEN % 1.0 * (end - begin)).astype(np.int64)


def _sample_pairs(batch: RayBatch, begin: int, end: int) -> RayBatch:
    """Return neighbours among rays `begin` to `end`, a pair after the other."""
    firsts = spread_samples(begin, end - 1, _SAMPLES)
    return batch.take(np.stack((firsts, firsts + 1), axis=1).reshape(-1))


KeyOrder: TypeAlias = Callable[[int, Callable[[int, int, NDArray[np.int32]], object]], NDArray[np.int32]]
"""A function that orders items by keys, see `Call.order_by_keys`."""


def sort_rays(
    batch: RayBatch, begin: int, end: int, box: TreeBox, order_by_keys: KeyOrder, *, is_pencil: bool = False
) -> NDArray[np.int32]:
    """Return the order in which to cast rays `begin` to `end`, counted from `begin`; the rays need not be valid.

    The rays of a pencil are told apart by where they leave the box alone, in finer cells.
    """
    grid = make_grid(box, FINE_CELLS_PER_AXIS if is_pencil else CELLS_PER_AXIS)

    def make_keys(first: int, last: int, keys: NDArray[np.int32]) -> None:
        _LOOPS.write_keys(batch.addresses, begin + first, grid, is_pencil, keys)

    return order_by_keys(end - begin, make_keys)


# Shorter rows, or fewer of them, are hardly larger than a tile.
_LEAST_ROW_LENGTH = 32
_LEAST_ROWS = 16


def is_picture_size(row_length: int, row_count: int) -> bool:
    """Say whether a picture of this size has rows worth casting tile by tile."""
    return row_length >= _LEAST_ROW_LENGTH and row_count >= _LEAST_ROWS


def find_row_length(batch: RayBatch) -> int | None:
    """Return the number of rays in a row if the batch is a picture, None if it is none.

    Notes
    -----
    Results do not depend on the answer, only their time. The search takes 0.1 ms for rows of 4,000 rays, and 10 ms at
    most.
    """
    if batch.ray_count < _LEAST_ROW_LENGTH * _LEAST_ROWS:
        return None
    return _PICTURES.find_row_length(batch.addresses, 0, batch.ray_count, _LEAST_ROW_LENGTH, _LEAST_ROWS) or None

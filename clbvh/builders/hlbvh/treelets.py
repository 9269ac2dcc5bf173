"""Buckets: blocks of grid cells whose primitives become one subtree each.

A block is what the first bits of a Morton code have in common, so it is a box of two to one or a cube. Dense regions
get small blocks, sparse ones large blocks.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...simd import store_row
from ..metadata import PRIM_ID, box_of


@njit(cache=True, nogil=True)
def cut_buckets(counts, limit, bucket_of_cell, first_cells):  # type: ignore[no-untyped-def]
    """Gather the cells into the largest blocks that hold at most `limit` primitives, or that are one cell.

    Parameters
    ----------
    counts : (cells,) int
        Primitives in each cell, in Morton order; a power of two of cells.
    limit : int
    bucket_of_cell : (cells,) int32, written
    first_cells : (cells,) int64, written
        The first cell of each bucket.

    Returns
    -------
    int
        Number of buckets. None is empty.
    """
    cell_count = len(counts)
    sums = np.zeros(cell_count + 1, np.int64)
    for cell in range(cell_count):
        sums[cell + 1] = sums[cell] + counts[cell]

    bucket_count = 0
    cell = 0
    while cell < cell_count:
        # Blocks begin at multiples of their size.
        size = cell & -cell if cell > 0 else cell_count
        while size > 1 and sums[cell + size] - sums[cell] > limit:
            size >>= 1
        if sums[cell + size] > sums[cell]:
            bucket_of_cell[cell : cell + size] = bucket_count
            first_cells[bucket_count] = cell
            bucket_count += 1
        cell += size
    return bucket_count


@njit(cache=True, nogil=True)
def fill_buckets(  # type: ignore[no-untyped-def]
    vertices, faces, begin, end, cells, bucket_of_cell, next_rows, rows, row_ints
):
    """Write the records of one slice of the primitives into their buckets, in their order.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int32
    begin, end : int
        The slice.
    cells : (F,) uint16
        The cell of each primitive.
    bucket_of_cell
        See `cut_buckets`.
    next_rows : (buckets,) int64, overwritten
        Where the slice's first record of each bucket goes.
    rows, row_ints : (2F, 8) float32 and int32, the same memory, written
        Records, see `metadata`.
    """
    for prim in range(begin, end):
        bucket = bucket_of_cell[cells[prim]]
        row = next_rows[bucket]
        next_rows[bucket] = row + 1
        store_row(rows, row, box_of(vertices, faces, prim))
        row_ints[row, PRIM_ID] = prim

"""Treelets: blocks of cells of a cubic grid whose primitives become one subtree each.

A cell's Morton code has the bits of its three coordinates in turn, x first, so cells that share the first bits of their
codes share a box: G. M. Morton, "A computer oriented geodetic data base", 1966. All cells of a block share the first
bits, so a block is a cube, or two or four cubes. Dense regions get small blocks, sparse ones large blocks.
"""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import bins_of, empty_box, lane_of, load_box, load_point, store_box, unite
from ...geometry.morton import SPREAD_BITS
from ...structs import BOX_LANES, PRIM_REF_ID
from ...support.compiled import compiled
from ..prim_refs import BOUNDS_BOX, BOUNDS_CENTROIDS, box_of
from ..sah.split import bin_scales


@compiled
def make_grid(centroid_bounds, row, axis_bits):
    """Return a cubic grid over a box of centroids.

    Parameters
    ----------
    centroid_bounds : (k, 8) float32
        `centroid_bounds[row]` is the box.
    axis_bits : int
        The grid has ``2 ** axis_bits`` cells along the longest axis; at most `morton.MAX_AXIS_BITS`.

    Returns
    -------
    (2, 8) float32
        Row 0: the lower corner. Row 1: cells per unit of length, the same in every lane.
    """
    grid = np.empty((2, BOX_LANES), np.float32)
    scales = bin_scales(load_box(centroid_bounds, row), 1 << axis_bits)
    smallest = np.float32(0.0)  # of all axes that are not flat
    for axis in range(3):
        scale = lane_of(scales, axis)
        if scale > 0 and (smallest == 0 or scale < smallest):
            smallest = scale
    for lane in range(BOX_LANES):
        grid[0, lane] = centroid_bounds[row, lane]
        grid[1, lane] = smallest
    return grid


@compiled
def bound_points(points, begin, end, bounds):
    """Bound the points from `begin` to `end`: no centroid lies outside.

    Parameters
    ----------
    points : (m, 3) float32
    bounds : (2, 8) float32, written
        Their box, and the box of their doubled coordinates, as centroids are doubled.
    """
    box = empty_box()
    for point in range(begin, end):
        box = unite(load_point(points, point), box)
    store_box(bounds, BOUNDS_BOX, box)
    for lane in range(BOX_LANES):
        bounds[BOUNDS_CENTROIDS, lane] = 2 * bounds[BOUNDS_BOX, lane]


@compiled
def code_of(box, lower, scales):
    """Return the Morton code of the cell of a box's centroid; `lower` and `scales` are the rows of the grid."""
    x, y, z = bins_of(box, lower, scales)
    return np.int64(SPREAD_BITS[x]) << 2 | np.int64(SPREAD_BITS[y]) << 1 | np.int64(SPREAD_BITS[z])


@compiled
def count_cells(prim_slice, grid, cells, counts):
    """Find the cell of each primitive of a slice, by its centroid, and count the primitives of each cell.

    Parameters
    ----------
    prim_slice : PrimSlice
    grid : (2, 8) float32
    cells : (F,) uint16, written
    counts : (cells,) int32, added to
    """
    points, ids = prim_slice.points, prim_slice.ids
    lower, scales = load_box(grid, 0), load_box(grid, 1)
    for prim in range(prim_slice.begin, prim_slice.end):
        box = box_of(points, ids, prim)
        cell = code_of(box, lower, scales)
        cells[prim] = cell
        counts[cell] += 1


@compiled
def cut_treelets(counts, limit, treelet_of_cell, first_cells):
    """Gather the cells into the largest blocks that hold at most `limit` primitives, or that are one cell.

    Parameters
    ----------
    counts : (cells,) int
        Primitives in each cell, in Morton order; a power of two of cells.
    limit : int
    treelet_of_cell : (cells,) int32, written
    first_cells : (cells,) int64, written
        The first cell of each treelet.

    Returns
    -------
    int
        Number of treelets. None is empty.
    """
    cell_count = len(counts)
    sums = np.zeros(cell_count + 1, np.int64)
    for cell in range(cell_count):
        sums[cell + 1] = sums[cell] + counts[cell]

    treelet_count = 0
    cell = 0
    while cell < cell_count:
        # Blocks begin at multiples of their size.
        size = cell & -cell if cell > 0 else cell_count
        while size > 1 and sums[cell + size] - sums[cell] > limit:
            size >>= 1
        if sums[cell + size] > sums[cell]:
            treelet_of_cell[cell : cell + size] = treelet_count
            first_cells[treelet_count] = cell
            treelet_count += 1
        cell += size
    return treelet_count


@compiled
def fill_treelets(prim_slice, cells, treelet_of_cell, next_slots, refs):
    """Write the primitive references of one slice into their treelets, in their order.

    Parameters
    ----------
    prim_slice : PrimSlice
    cells : (F,) uint16
        The cell of each primitive.
    treelet_of_cell
        See `cut_treelets`.
    next_slots : (treelets,) int64, overwritten
        The slot of the slice's first primitive reference in each treelet.
    refs : (2F, 8) float32, written
    """
    points, ids = prim_slice.points, prim_slice.ids
    ref_ints = refs.view(np.int32)
    for prim in range(prim_slice.begin, prim_slice.end):
        treelet = treelet_of_cell[cells[prim]]
        slot = next_slots[treelet]
        next_slots[treelet] = slot + 1
        store_box(refs, slot, box_of(points, ids, prim))
        ref_ints[slot, PRIM_REF_ID] = prim

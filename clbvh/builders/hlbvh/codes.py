"""Morton codes: the number of a cell of a cubic grid, neighbours near each other.

The bits of the three coordinates take turns, x first, so cells that share the first bits of their codes share a box:
G. M. Morton, "A computer oriented geodetic data base", 1966.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...morton_bits import SPREAD_BITS
from ...simd import LANES, bins_of, empty_box, lane_of, load_point, load_row, store_row, unite
from ..metadata import box_of
from ..splits import bin_scales


@njit(cache=True, nogil=True)
def make_grid(centroid_bounds, row, axis_bits):  # type: ignore[no-untyped-def]
    """Return a cubic grid over a box of centroids.

    Parameters
    ----------
    centroid_bounds : (k, 8) float32
        `centroid_bounds[row]` is the box.
    axis_bits : int
        The grid has ``2 ** axis_bits`` cells along the longest axis; at most `morton_bits.MAX_AXIS_BITS`.

    Returns
    -------
    (2, 8) float32
        The lower corner, and how many cells there are per unit of length, the same in every lane.
    """
    grid = np.empty((2, LANES), np.float32)
    scales = bin_scales(centroid_bounds, row, 1 << axis_bits)
    smallest = np.float32(0.0)  # of all axes that are not flat
    for axis in range(3):
        scale = lane_of(scales, axis)
        if scale > 0 and (smallest == 0 or scale < smallest):
            smallest = scale
    for lane in range(LANES):
        grid[0, lane] = centroid_bounds[row, lane]
        grid[1, lane] = smallest
    return grid


@njit(cache=True, nogil=True)
def bound_vertices(vertices, begin, end, bounds):  # type: ignore[no-untyped-def]
    """Bound the vertices from `begin` to `end`: no centroid lies outside.

    Parameters
    ----------
    vertices : (V, 3) float32
    bounds : (2, 8) float32, written
        Row 0: their box. Row 1: the box of their doubled coordinates, as centroids are doubled.
    """
    box = empty_box()
    for vertex in range(begin, end):
        box = unite(load_point(vertices, vertex), box)
    store_row(bounds, 0, box)
    for lane in range(LANES):
        bounds[1, lane] = 2 * bounds[0, lane]


@njit(cache=True, nogil=True)
def code_of(box, lower, scales):  # type: ignore[no-untyped-def]
    """Return the Morton code of the cell in which a box has its centroid; the grid's two rows as boxes."""
    x, y, z = bins_of(box, lower, scales)
    return np.int64(SPREAD_BITS[x]) << 2 | np.int64(SPREAD_BITS[y]) << 1 | np.int64(SPREAD_BITS[z])


@njit(cache=True, nogil=True)
def count_cells(vertices, faces, begin, end, grid, cells, counts):  # type: ignore[no-untyped-def]
    """Find the cell of each primitive from `begin` to `end`, by its centroid, and add up how many each cell has.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int32
    grid : (2, 8) float32
    cells : (F,) uint16, written
    counts : (cells,) int32, added to
    """
    lower, scales = load_row(grid, 0), load_row(grid, 1)
    for prim in range(begin, end):
        box = box_of(vertices, faces, prim)
        cell = code_of(box, lower, scales)
        cells[prim] = cell
        counts[cell] += 1

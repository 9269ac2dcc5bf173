"""The grid cells where rays enter and leave the tree's box: coherence and order of rays are judged by them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from .batch import TreeBox
from .ray_rows import row_step

# Cells along each axis of the box: 4 bits of a key.
CELLS_PER_AXIS = 16

# Cells of a ray: of its entry along x, y and z, then of its exit.
CELLS_PER_RAY = 6

# Cells are found for this many rays at a time, in vector instructions.
BLOCK = 64

# Lanes of a block: three for the origin, three for the direction, then the interval in the box.
_ORIGIN, _DIRECTION, _T_NEAR, _T_FAR, _LANES = 0, 3, 6, 7, 8

# A box that is thinner along an axis has one cell there: the number of cells to a unit has to fit float32.
_THINNEST = np.float32(2.0**-100)


class Grid(NamedTuple):
    """A grid over a box.

    Attributes
    ----------
    centre : (3,) float64, the file's coordinates
    scale : float
        Local units in one unit of the file.
    half, cells_per_unit : (3,) float32, local units
    """

    centre: NDArray[np.float64]
    scale: float
    half: NDArray[np.float32]
    cells_per_unit: NDArray[Any]


class Block(NamedTuple):
    """Working memory for the cells of a block of rays.

    Attributes
    ----------
    lanes : (8, BLOCK) float32
    cells : (6, BLOCK) int32
        See `CELLS_PER_RAY`.
    """

    lanes: NDArray[np.float32]
    cells: NDArray[np.int32]


def make_grid(box: TreeBox) -> Grid:
    """Return the grid over a box."""
    half = box.half.astype(np.float32)
    return Grid(box.centre, box.scale, half, np.float32(0.5 * CELLS_PER_AXIS) / np.maximum(half, _THINNEST))


def make_block() -> Block:
    """Return working memory for `find_cells`."""
    return Block(np.zeros((_LANES, BLOCK), np.float32), np.empty((CELLS_PER_RAY, BLOCK), np.int32))


@compiled
def meets_box(block, ray):
    """Say whether a ray of a block meets the box."""
    return not block.lanes[_T_NEAR, ray] > block.lanes[_T_FAR, ray]


@compiled(error_model="numpy")
def find_cells(rays, grid, first, count, block):
    """Write the cells where the interval of each ray in the box begins and ends, for rays `first` to `first + count`.

    In float32: cells of rays from very far, or with directions of a length beyond float32, are wrong, which costs
    locality and nothing else. There are no branches.
    Comparisons are written so that NaN, of a ray in a face of the box, changes nothing and falls into the first cell.

    Parameters
    ----------
    rays : RayRows
    grid : Grid
    first, count : int
        At most `BLOCK` rays.
    block : Block, written
    """
    lanes, cells, half, cells_per_unit = block.lanes, block.cells, grid.half, grid.cells_per_unit
    # Twice as fast as with the lanes in a loop.
    origin_step, direction_step = row_step(rays.origins), row_step(rays.directions)
    starts, along = rays.origins[first * origin_step :], rays.directions[first * direction_step :]
    centre_x, centre_y, centre_z, scale = grid.centre[0], grid.centre[1], grid.centre[2], grid.scale
    x, y, z = lanes[_ORIGIN], lanes[_ORIGIN + 1], lanes[_ORIGIN + 2]
    dx, dy, dz = lanes[_DIRECTION], lanes[_DIRECTION + 1], lanes[_DIRECTION + 2]
    for ray in range(count):
        start = ray * origin_step
        x[ray] = (starts[start, 0] - centre_x) * scale
        y[ray] = (starts[start, 1] - centre_y) * scale
        z[ray] = (starts[start, 2] - centre_z) * scale
    for ray in range(count):
        way = ray * direction_step
        dx[ray], dy[ray], dz[ray] = along[way, 0], along[way, 1], along[way, 2]
    for limits, lane in ((rays.t_min, lanes[_T_NEAR]), (rays.t_max, lanes[_T_FAR])):
        limit_step = row_step(limits)
        for ray in range(count):
            lane[ray] = limits[(first + ray) * limit_step] * scale

    # The interval in the box.
    zero, one, last_cell = np.float32(0.0), np.float32(1.0), np.float32(CELLS_PER_AXIS - 1)
    for axis in range(3):
        for ray in range(BLOCK):
            origin, inverse = lanes[_ORIGIN + axis, ray], one / lanes[_DIRECTION + axis, ray]
            lower, upper = (-half[axis] - origin) * inverse, (half[axis] - origin) * inverse
            near, far = (upper, lower) if inverse < zero else (lower, upper)
            t_near, t_far = lanes[_T_NEAR, ray], lanes[_T_FAR, ray]
            lanes[_T_NEAR, ray] = near if near > t_near else t_near
            lanes[_T_FAR, ray] = far if far < t_far else t_far

    # The cells at its ends.
    for axis in range(3):
        for ray in range(BLOCK):
            origin, direction = lanes[_ORIGIN + axis, ray] + half[axis], lanes[_DIRECTION + axis, ray]
            begin = (origin + lanes[_T_NEAR, ray] * direction) * cells_per_unit[axis]
            end = (origin + lanes[_T_FAR, ray] * direction) * cells_per_unit[axis]
            begin, end = begin if begin > zero else zero, end if end > zero else zero
            cells[axis, ray] = np.int32(begin if begin < last_cell else last_cell)
            cells[3 + axis, ray] = np.int32(end if end < last_cell else last_cell)

"""The grid cells where rays enter and leave the tree's box: coherence and order of rays are judged by them.

Cells are found in float32: those of rays from very far, or with directions of a length beyond float32, are wrong, which
costs locality and nothing else. There are no branches, so that loops over rays become vector instructions. Comparisons
are written so that NaN, of a ray in a face of the box, changes nothing and falls into the first cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from .batch import TreeBox
from .ray_rows import RayRows

# Cells along each axis of the box where six numbers make a key, those of the entry and of the exit: 4 bits of it.
CELLS_PER_AXIS = 16

# Where the three numbers of the exit make a key: 8 bits of it.
FINE_CELLS_PER_AXIS = 256

# A box that is thinner along an axis has one cell there: the number of cells to a unit has to fit float32.
_THINNEST = np.float32(2.0**-100)

# Rays of a part: few enough that what is repeated for each stays in the cache.
_PART_RAYS = 1 << 14

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


class Grid(NamedTuple):
    """A grid over a box.

    Attributes
    ----------
    centre : 3 float, the file's coordinates
    scale : float
        Local units in one unit of the file.
    half, cells_per_unit : 3 float32, local units
    last_cell : float32
        Cells along each axis, less 1.
    """

    # No arrays: keys that are written might change them, and compiled loops would read them again for each ray.
    centre: tuple[float, float, float]
    scale: float
    half: tuple[np.float32, np.float32, np.float32]
    cells_per_unit: tuple[np.float32, np.float32, np.float32]
    last_cell: np.float32


class FlatRays(NamedTuple):
    """Rays in arrays without a second dimension: loops over them know the distance from ray to ray.

    Attributes
    ----------
    origins, directions : (3 n,), both float32 or both float64, the file's coordinates
    t_min, t_max : (n,) float64, lengths of the direction
    """

    origins: NDArray[Any]
    directions: NDArray[Any]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]


def make_grid(box: TreeBox, cells_per_axis: int = CELLS_PER_AXIS) -> Grid:
    """Return the grid over a box."""
    half = box.half.astype(np.float32)
    cells_per_unit = np.float32(0.5 * cells_per_axis) / np.maximum(half, _THINNEST)
    last_cell = np.float32(cells_per_axis - 1)
    return Grid(tuple(box.centre.tolist()), box.scale, tuple(half), tuple(cells_per_unit), last_cell)


def flatten_rays(rays: RayRows, ray_count: int) -> Iterator[tuple[int, FlatRays]]:
    """Yield parts of rays, each with the index of its first ray; what one row holds for all rays is repeated."""
    part_count = min(ray_count, _PART_RAYS)
    arrays = [_repeat(values, part_count) if len(values) == 1 else values for values in rays]
    for begin in range(0, ray_count, _PART_RAYS):
        end = min(begin + _PART_RAYS, ray_count)
        parts = (
            array[: end - begin] if len(values) == 1 else array[begin:end]
            for array, values in zip(arrays, rays, strict=True)
        )  # fmt: skip
        yield begin, FlatRays(*(part.reshape(-1) for part in parts))


def _repeat(values: NDArray[Any], count: int) -> NDArray[Any]:
    repeated = np.repeat(values, count, axis=0)
    # As the other arrays of rays are: numba would compile another version of each function.
    repeated.flags.writeable = False
    return repeated


@compiled(error_model="numpy")
def find_interval(rays, grid, ray):
    """Return origin and direction of a ray in local coordinates, and begin and end of its interval in the box."""
    origins, directions, centre, scale, half = rays.origins, rays.directions, grid.centre, grid.scale, grid.half
    x = np.float32((origins[3 * ray] - centre[0]) * scale)
    y = np.float32((origins[3 * ray + 1] - centre[1]) * scale)
    z = np.float32((origins[3 * ray + 2] - centre[2]) * scale)
    dx, dy = np.float32(directions[3 * ray]), np.float32(directions[3 * ray + 1])
    dz = np.float32(directions[3 * ray + 2])
    t_near, t_far = np.float32(rays.t_min[ray] * scale), np.float32(rays.t_max[ray] * scale)
    t_near, t_far = _clip(x, dx, half[0], t_near, t_far)
    t_near, t_far = _clip(y, dy, half[1], t_near, t_far)
    t_near, t_far = _clip(z, dz, half[2], t_near, t_far)
    return (x, y, z), (dx, dy, dz), t_near, t_far


@compiled(error_model="numpy")
def _clip(origin, direction, half, t_near, t_far):
    """Narrow an interval of a ray to the part between -half and half on one axis."""
    inverse = _ONE / direction
    lower, upper = (-half - origin) * inverse, (half - origin) * inverse
    near = upper if inverse < _ZERO else lower
    far = lower if inverse < _ZERO else upper
    return near if near > t_near else t_near, far if far < t_far else t_far


@compiled
def find_cell(origin, direction, t, grid, axis):
    """Return the number along an axis of the cell in which a ray is at t."""
    cell = (origin[axis] + grid.half[axis] + t * direction[axis]) * grid.cells_per_unit[axis]
    cell = cell if cell > _ZERO else _ZERO
    return np.int32(cell if cell < grid.last_cell else grid.last_cell)

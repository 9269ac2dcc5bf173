"""The order in which rays are cast: whether they are a picture, or coherent, and if not, an order by cells of a grid.

Rays that follow each other in a picture take similar ways through the tree. Scattered rays wait for memory at nearly
every node; sorted by the grid cells where they enter and leave the tree's box, neighbours share what is in the cache
(Moon et al., "Cache-oblivious ray reordering", 2010).

Cells are found in float32: those of rays from very far, or with directions of a length beyond float32, are wrong, which
costs locality and nothing else. There are no branches, so that loops over rays become vector instructions. Comparisons
are written so that NaN, of a ray in a face of the box, changes nothing and falls into the first cell.

The neighbours of a picture's ray in the rows above and below are as close as those in its own row. A flat array of rays
does not say how long its rows are, but a walk along it leads away from a ray and comes back to it one row later. A
scan all around, of which no row has an end, is a picture as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from ..world.tree_box import TreeBox
from .batch import RayBatch, RayRows, row_step

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


KeyOrder: TypeAlias = Callable[[int, Callable[[int, int, NDArray[np.int32]], object]], NDArray[np.int32]]
"""A function that orders items by keys, see `Call.order_by_keys`."""

# Above the 24 bits of the others: these rays come last.
_LAST_KEY = np.int32(1 << 24)


def sort_rays(
    batch: RayBatch, begin: int, end: int, box: TreeBox, order_by_keys: KeyOrder, *, is_pencil: bool = False
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

    return order_by_keys(end - begin, make_keys)


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


# Shorter rows, or fewer of them, are hardly larger than a tile.
_LEAST_ROW_LENGTH = 32
_LEAST_ROWS = 16
_MOST_ROW_LENGTH = 1 << 16

# Two rays are near each other if they are at most this many mean steps from ray to ray apart: pixels may be oblong, and
# rays jittered.
_NEAR_STEPS = 8

# Rows sampled; this many must have a nearby next row. At the poles of a scan all around, rows are short.
_ROW_SAMPLES = 32
_LEAST_GOOD_SAMPLES = 24

# Rays that are searched where parts of the batch have to be copied.
_MOST_COPIED = 1 << 20

_NONE = 0


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
    ray_count = batch.ray_count if batch.is_contiguous else min(batch.ray_count, _MOST_COPIED)
    vectors = batch.vectors(0, ray_count)
    row_length = _find_return(vectors, ray_count)
    return row_length if row_length != _NONE and _are_rows_near(vectors, ray_count, row_length) else None


@compiled
def _distance(vectors, one, other):
    origins, directions = vectors
    one_origin, other_origin = one * row_step(origins), other * row_step(origins)
    one_direction, other_direction = one * row_step(directions), other * row_step(directions)
    squares = 0.0
    for axis in range(3):
        squares += (np.float64(origins[one_origin, axis]) - np.float64(origins[other_origin, axis])) ** 2
        squares += (np.float64(directions[one_direction, axis]) - np.float64(directions[other_direction, axis])) ** 2
    return math.sqrt(squares)


@compiled
def _find_return(vectors, ray_count):
    """Return the number of rays after which a walk from the middle of the batch comes back to its beginning."""
    begin = ray_count // 2
    travelled = 0.0
    was_away = False
    for row_length in range(1, min(ray_count // _LEAST_ROWS, _MOST_ROW_LENGTH) + 1):
        travelled += _distance(vectors, begin + row_length - 1, begin + row_length)
        near = _NEAR_STEPS * travelled / row_length
        is_near = _distance(vectors, begin, begin + row_length) <= near
        if was_away and is_near:
            return _find_nearest_row(vectors, ray_count, row_length) if row_length >= _LEAST_ROW_LENGTH else _NONE
        # Written so that NaN is not away.
        was_away = was_away or _distance(vectors, begin, begin + row_length) > near
    return _NONE


@compiled
def _find_nearest_row(vectors, ray_count, row_length):
    """Return the length, of this one and the next ones, for which the next row is nearest."""
    nearest, least = row_length, np.inf
    # The jump at the end of a row makes mean steps look twice as long, so "near" may reach twice as far, before the
    # row and behind it.
    for candidate in range(row_length, row_length + 4 * _NEAR_STEPS + 1):
        total = 0.0
        for sample in range(_ROW_SAMPLES):
            ray = sample * (ray_count - 1 - candidate) // _ROW_SAMPLES
            total += _distance(vectors, ray, ray + candidate)
        if total < least:
            nearest, least = candidate, total
    return nearest


@compiled
def _are_rows_near(vectors, ray_count, row_length):
    """Say whether the next row is near for enough samples, and the middle of a row far from its beginning."""
    row_count = ray_count // row_length
    good = 0
    for sample in range(_ROW_SAMPLES):
        begin = sample * (row_count - 1) // _ROW_SAMPLES * row_length
        half = row_length // 2
        travelled = 0.0
        for ray in range(begin, begin + half):
            travelled += _distance(vectors, ray, ray + 1)
        near = _NEAR_STEPS * travelled / half
        ray = begin + half * sample // _ROW_SAMPLES
        good += _distance(vectors, begin, begin + half) > near and _distance(vectors, ray, ray + row_length) <= near
    return good >= _LEAST_GOOD_SAMPLES

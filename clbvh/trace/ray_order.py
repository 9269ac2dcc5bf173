"""In which order a device takes rays: those that follow each other should take the same way through the tree.

Rays in any order wait for memory at nearly every node; those of neighbouring work-items share what is in the cache. So
a batch whose neighbours lie apart is sorted by where its rays enter and leave the box, and the device writes each
result where the ray was (Moon et al., "Cache-oblivious ray reordering", 2010).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..host_threads import HostThreads
from .key_order import LAST_KEY, order_by_keys
from .rays import RayBatch, RayBox

# Fewer rays earn back neither the sort nor the search for entries: it takes as long as it saves at 16,384 rays of a
# picture, and 65,536 are 1.1 times as fast with it. The sort, whole calls, sorted against as they are, closest, any and
# all hits, medians on 2 cores of an x86-64 server, dragon:
#            shuffled picture    from around         from anywhere       in any order from the surface
# 32,768     0.99 0.87 0.72      0.81 0.89 1.01      1.11 1.02 0.99      1.09 1.43 1.10
# 65,536     0.84 0.75 0.63      0.99 0.94 0.93      1.08 1.07 0.94      1.00 0.96 0.89
# 131,072    0.79 0.65 0.55      0.89 0.98 0.84      1.08 0.97 0.86      0.93 0.83 0.81
LEAST_RAYS = 1 << 16
_FEWEST = 2

# Cells along each axis of the box, 4 bits of a key; a key has six of them. Rays that miss the box come last.
_CELLS = 16
_KEY_AXES = 6

# A box that is smaller along an axis has one cell there: the number of cells to a unit fits float32.
_SMALLEST = np.float32(2.0**-100)

# Cells are found for so many rays at a time, in vector instructions: these lanes of each, and three for each axis.
_BLOCK = 64
_ORIGIN, _DIRECTION, _ENTER, _LEAVE, _LANES = 0, 3, 6, 7, 8

# Neighbours in so many places of a batch are looked at. They are apart if this share of them are not in the same or in
# adjoining cells: few of a picture's rays are not, and most of those in any order.
_SAMPLES = 128

# Samples are so far from each other, modulo the batch: no whole number of a picture's rows.
_GOLDEN = (5**0.5 - 1) / 2
_LEAST_APART = 0.25


class RayOrder(NamedTuple):
    """In which order to cast rays.

    Attributes
    ----------
    numbers : (n,) int32, or None
        The rays, one after the other; None for as they are.
    is_coherent : bool
        Whether rays beside each other are known to go the same way as they are, so that they may begin together, see
        cl/entry.cl.
    """

    numbers: NDArray[np.int32] | None
    is_coherent: bool


def are_many(count: int) -> bool:
    """Whether so many rays earn back what is found out about them."""
    return count >= max(LEAST_RAYS, _FEWEST)


def find_order(
    batch: RayBatch, begin: int, end: int, box: RayBox, threads: HostThreads, *, is_picture: bool = False
) -> RayOrder:
    """Return in which order to cast rays `begin` to `end`, counted from `begin`; the rays need not be valid."""
    count = end - begin
    if not are_many(count):
        return RayOrder(None, False)
    if is_picture or not _is_scattered(batch, begin, end, box):
        return RayOrder(None, True)

    def make_keys(first: int, last: int, keys: NDArray[np.int32]) -> None:
        _make_keys(keys, *_with_cells(batch.part(begin + first, begin + last), box))

    return RayOrder(order_by_keys(count, threads, make_keys), False)


def _is_scattered(batch: RayBatch, begin: int, end: int, box: RayBox) -> bool:
    """Return whether rays that follow each other take different ways, by a sample."""
    firsts = begin + (np.arange(_SAMPLES) * _GOLDEN % 1.0 * (end - begin - 1)).astype(np.int64)
    pairs = batch.take(np.stack((firsts, firsts + 1), axis=1).reshape(-1)).part(0, 2 * _SAMPLES)
    shares: tuple[float, float, float] = _measure_apart(*_with_cells(pairs, box))
    entrances, exits, far_entrances = shares
    # Rays that leave a surface in all directions, point after point, share the nodes around it: sorting them gains
    # nothing. Rays of one eye inside of the box all begin there, in any order.
    return bool(entrances >= _LEAST_APART or (exits >= _LEAST_APART and far_entrances < _LEAST_APART))


def _with_cells(batch: RayBatch, box: RayBox) -> tuple[Any, ...]:
    """Return what `_find_cells` takes: the rays, half the box, and how many cells there are to a unit of length."""
    half = box.half.astype(np.float32)
    scale = np.float32(0.5 * _CELLS) / np.maximum(half, _SMALLEST)
    return batch.origins, batch.directions, batch.t_min, batch.t_max, box.centre, half, scale


@njit(cache=True, nogil=True, error_model="numpy")
def _make_keys(keys, origins, directions, t_mins, t_maxs, centre, half, scale):  # type: ignore[no-untyped-def]
    """Write the keys of rays."""
    lanes, cells = _make_block()
    for first in range(0, len(keys), _BLOCK):
        count = min(_BLOCK, len(keys) - first)
        _find_cells(origins, directions, t_mins, t_maxs, centre, half, scale, first, count, lanes, cells)
        for ray in range(_BLOCK):
            key = np.int32(0)
            for axis in range(_KEY_AXES):
                # The bits of a cell's number with five zeros between them: six numbers interlock, a Morton code.
                cell = cells[axis, ray]
                key |= ((cell & 1) | (cell & 2) << 5 | (cell & 4) << 10 | (cell & 8) << 15) << axis
            cells[0, ray] = key if _meets(lanes, ray) else np.int32(LAST_KEY)
        for ray in range(count):
            keys[first + ray] = cells[0, ray]


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_apart(origins, directions, t_mins, t_maxs, centre, half, scale):  # type: ignore[no-untyped-def]
    """Return which shares of rays that come in pairs are more than a cell apart, of those that meet the box.

    Where the rays of a pair enter it, where they leave it, and where those of different pairs enter it.
    """
    lanes, cells = _make_block()
    all_cells, meets = np.empty((len(origins), _KEY_AXES), np.int32), np.empty(len(origins), np.bool_)
    for first in range(0, len(origins), _BLOCK):
        _find_cells(origins, directions, t_mins, t_maxs, centre, half, scale, first, _BLOCK, lanes, cells)
        for ray in range(_BLOCK):
            meets[first + ray] = _meets(lanes, ray)
            for axis in range(_KEY_AXES):
                all_cells[first + ray, axis] = cells[axis, ray]
    considered, entrances, exits, far_entrances = 0, 0, 0, 0
    for ray in range(0, len(origins), 2):
        if not (meets[ray] or meets[ray + 1]):
            continue
        considered += 1
        is_alone = meets[ray] != meets[ray + 1]
        entrances += is_alone or _are_apart(all_cells[ray, :3], all_cells[ray + 1, :3])
        exits += is_alone or _are_apart(all_cells[ray, 3:], all_cells[ray + 1, 3:])
        far_entrances += _are_apart(all_cells[ray, :3], all_cells[(ray + len(origins) // 2) % len(origins), :3])
    return entrances / max(considered, 1), exits / max(considered, 1), far_entrances / max(considered, 1)


@njit(cache=True, nogil=True)
def _are_apart(one, other):  # type: ignore[no-untyped-def]
    """Whether two cells neither are the same nor touch."""
    return max(abs(one[0] - other[0]), abs(one[1] - other[1]), abs(one[2] - other[2])) > 1


@njit(cache=True, nogil=True)
def _make_block():  # type: ignore[no-untyped-def]
    """Return what `_find_cells` works in."""
    return np.zeros((_LANES, _BLOCK), np.float32), np.empty((_KEY_AXES, _BLOCK), np.int32)


@njit(cache=True, nogil=True)
def _meets(lanes, ray):  # type: ignore[no-untyped-def]
    """Whether a ray of a block meets the box."""
    return not lanes[_ENTER, ray] > lanes[_LEAVE, ray]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_cells(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, centre, half, scale, first, count, lanes, cells
):
    """Write in which cells rays enter and leave the box, or begin and end, and how far along them that is.

    In float32: of rays from very far the cells are wrong, which costs locality and nothing else. There are no branches,
    and comparisons are written so that NaN, of a ray in the face of a box, changes nothing and is in the first cell.
    """
    # Twice as fast as with the lanes in a loop.
    starts, along = origins[first : first + count], directions[first : first + count]
    centre_x, centre_y, centre_z = centre[0], centre[1], centre[2]
    x, y, z = lanes[_ORIGIN], lanes[_ORIGIN + 1], lanes[_ORIGIN + 2]
    dx, dy, dz = lanes[_DIRECTION], lanes[_DIRECTION + 1], lanes[_DIRECTION + 2]
    for ray in range(count):
        x[ray], y[ray], z[ray] = starts[ray, 0] - centre_x, starts[ray, 1] - centre_y, starts[ray, 2] - centre_z
        dx[ray], dy[ray], dz[ray] = along[ray, 0], along[ray, 1], along[ray, 2]
    for limits, lane in ((t_mins, lanes[_ENTER]), (t_maxs, lanes[_LEAVE])):
        if len(limits) > 1:
            for ray in range(count):
                lane[ray] = limits[first + ray]
        else:
            lane[:] = limits[0]
    zero, one, last_cell = np.float32(0.0), np.float32(1.0), np.float32(_CELLS - 1)
    for axis in range(3):
        for ray in range(_BLOCK):
            origin, inverse = lanes[_ORIGIN + axis, ray], one / lanes[_DIRECTION + axis, ray]
            lower, upper = (-half[axis] - origin) * inverse, (half[axis] - origin) * inverse
            near, far = (upper, lower) if inverse < zero else (lower, upper)
            enter, leave = lanes[_ENTER, ray], lanes[_LEAVE, ray]
            lanes[_ENTER, ray] = near if near > enter else enter
            lanes[_LEAVE, ray] = far if far < leave else leave
    for axis in range(3):
        for ray in range(_BLOCK):
            origin, direction = lanes[_ORIGIN + axis, ray] + half[axis], lanes[_DIRECTION + axis, ray]
            entrance = (origin + lanes[_ENTER, ray] * direction) * scale[axis]
            exit = (origin + lanes[_LEAVE, ray] * direction) * scale[axis]
            entrance, exit = entrance if entrance > zero else zero, exit if exit > zero else zero
            cells[axis, ray] = np.int32(entrance if entrance < last_cell else last_cell)
            cells[3 + axis, ray] = np.int32(exit if exit < last_cell else last_cell)

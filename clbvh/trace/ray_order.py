"""In which order a device takes rays: those that follow each other should take the same way through the tree.

Rays in any order wait for memory at nearly every node; those of neighbouring work-items share what is in the cache. So
a batch whose neighbours lie apart is sorted by where its rays enter and leave the box, and the device writes each
result where the ray was (Moon et al., "Cache-oblivious ray reordering", 2010).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..host_threads import HostThreads
from .rays import DIRECTION_LANE, RAY_LANES, T_MAX_LANE, T_MIN_LANE, RayBox

# Fewer rays do not earn back the sort. Whole calls at the dragon, 2-core x86-64 server, rays from anywhere in its box
# in any direction, sorted against as they are: at 65,536 rays 1.12 (closest) and 1.23 (any hit), at 131,072 1.02 and
# 1.15, at 262,144 1.00 and 1.00, at 524,288 0.97 and 0.94. A shuffled picture gains earlier: 0.61 to 0.86 at 100,000.
LEAST_RAYS = 1 << 18

# Cells along each axis of the box, 5 bits of a key; a key has six of them, and the ray's number below.
_CELLS = 32
_NUMBER_BITS = 32
_NUMBER_MASK = (1 << _NUMBER_BITS) - 1

# The bits of a cell's number, each with five zeros in front: so that six numbers interlock, a Morton code.
_SPREAD = np.array([sum((cell >> bit & 1) << 6 * bit for bit in range(5)) for cell in range(_CELLS)], np.int64)
_MISSES = np.int64(1 << 30)

# Neighbours in so many places of a batch are looked at. It is sorted if this share of them are not in the same or
# adjoining cells: few of a picture's rays are not, and most of those in any order.
_SAMPLES = 1024
_LEAST_APART = 0.25


def find_order(rays: NDArray[np.void], box: RayBox, threads: HostThreads) -> NDArray[np.int64] | None:
    """Return (n,) int64: the numbers of the rays in the order in which to cast them; None for as they are.

    Parameters
    ----------
    rays : (n,) `layout.RAY`
        Packed.
    box : RayBox
    threads : HostThreads
    """
    count = len(rays)
    if count < LEAST_RAYS:
        return None
    lanes = rays.view(np.float32).reshape(-1, RAY_LANES)
    scale = 0.5 * _CELLS / np.maximum(box.half, np.finfo(np.float32).tiny)
    if _measure_apart(lanes, box.half, scale, max(1, count // _SAMPLES)) < _LEAST_APART:
        return None
    keys = np.empty(count, np.int64)
    threads.for_ranges(count, lambda first, last: _sort_keys(lanes, box.half, scale, first, keys[first:last]))
    return keys


def take_rays(
    rays: NDArray[np.void],
    numbers: NDArray[np.int64],
    threads: HostThreads,
    ordered: NDArray[np.void],
    order: NDArray[np.int32],
) -> None:
    """Write rays in another order, and their numbers beside them.

    They are moved here and not where they are cast: a processor fetches many of them at once, and a traversal that
    begins with one waits for it.
    """
    source, target = (given.view(np.float32).reshape(-1, RAY_LANES) for given in (rays, ordered))
    threads.for_ranges(
        len(numbers),
        lambda first, last: _take(source, numbers[first:last], target[first:last], order[first:last]),
    )


def _sort_keys(lanes: NDArray[Any], half: Any, scale: Any, first: int, keys: NDArray[np.int64]) -> None:
    """Write the numbers of a range of rays in the order of their keys."""
    _make_keys(lanes, half, scale, first, keys)
    keys.sort()
    keys &= _NUMBER_MASK


@njit(cache=True, nogil=True)
def _take(source, numbers, target, order):  # type: ignore[no-untyped-def]
    for place in range(len(numbers)):
        ray = numbers[place]
        order[place] = ray
        for lane in range(RAY_LANES):
            target[place, lane] = source[ray, lane]


@njit(cache=True, nogil=True, error_model="numpy")
def _make_keys(lanes, half, scale, first, keys):  # type: ignore[no-untyped-def]
    cells = np.empty(6, np.int64)
    for row in range(len(keys)):
        key = _MISSES
        if _find_cells(lanes, first + row, half, scale, cells):
            key = np.int64(0)
            for axis in range(6):
                key |= _SPREAD[cells[axis]] << axis
        keys[row] = key << _NUMBER_BITS | (first + row)


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_apart(lanes, half, scale, step):  # type: ignore[no-untyped-def]
    """Return which share of the neighbours, of which one at least meets the box, are more than a cell apart."""
    one, other = np.empty(6, np.int64), np.empty(6, np.int64)
    considered, apart = 0, 0
    for ray in range(0, len(lanes) - 1, step):
        meets = _find_cells(lanes, ray, half, scale, one)
        if _find_cells(lanes, ray + 1, half, scale, other):
            considered += 1
            apart += not meets or np.abs(one - other).max() > 1
        elif meets:
            considered += 1
            apart += 1
    return apart / max(considered, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _find_cells(lanes, ray, half, scale, cells):  # type: ignore[no-untyped-def]
    """Write in which cells the ray enters and leaves the box, or begins and ends; return whether it meets the box."""
    enter, leave = np.float64(lanes[ray, T_MIN_LANE]), np.float64(lanes[ray, T_MAX_LANE])
    # Comparisons with NaN, of a ray in the face of a box, are false and change nothing.
    for axis in range(3):
        origin, inverse = np.float64(lanes[ray, axis]), 1.0 / np.float64(lanes[ray, DIRECTION_LANE + axis])
        near, far = (-half[axis] - origin) * inverse, (half[axis] - origin) * inverse
        if inverse < 0.0:
            near, far = far, near
        if near > enter:
            enter = near
        if far < leave:
            leave = far
    if enter > leave:
        return False
    for axis in range(3):
        origin, direction = np.float64(lanes[ray, axis]), np.float64(lanes[ray, DIRECTION_LANE + axis])
        cells[axis] = _cell_of((origin + enter * direction + half[axis]) * scale[axis])
        cells[3 + axis] = _cell_of((origin + leave * direction + half[axis]) * scale[axis])
    return True


@njit(cache=True, nogil=True)
def _cell_of(place):  # type: ignore[no-untyped-def]
    # Written so that NaN is in the first cell.
    if not place > 0.0:
        return 0
    return _CELLS - 1 if place >= _CELLS else int(place)

"""In which order a device takes points: those that follow each other should be close together, see ray_order.py."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..host_threads import HostThreads
from ..morton_bits import SPREAD_BITS
from .key_order import order_by_keys
from .rays import RayBox

# Fewer points stay in their order. Whole calls with 1,024, 4,096 and 16,384 points, sorted against as they are, 2 cores
# of an x86-64 server: 1.07, 0.77, 0.61 near the dragon, 0.92, 0.65, 0.63 anywhere in its box; 1.06, 0.87, 0.81 near the
# bunny, and 1.01, 0.73, 0.80.
LEAST_POINTS = 1 << 12

# Cells along each axis of a cube around the box, 8 bits of a key. Points outside of it are taken as at its border.
_CELLS = 256
_CUBE_SHARE = 2.0


def find_point_order(points: NDArray[Any], box: RayBox, threads: HostThreads) -> NDArray[np.int32]:
    """Return (n,) int32: the order in which to look for nearest points; they need not be finite.

    Parameters
    ----------
    points : (n, 3) float, contiguous
    box : RayBox
    threads : HostThreads
    """
    if len(points) < LEAST_POINTS:
        return np.arange(len(points), dtype=np.int32)
    half = _CUBE_SHARE * max(float(box.half.max()), float(np.finfo(np.float32).tiny))

    def make_keys(begin: int, end: int, keys: NDArray[np.int32]) -> None:
        _make_keys(points[begin:end], box.centre, half, _CELLS / (2 * half), keys)

    return order_by_keys(len(points), threads, make_keys)


@njit(cache=True, nogil=True)
def _make_keys(points, centre, half, scale, keys):  # type: ignore[no-untyped-def]
    for row in range(len(points)):
        key = 0
        for axis in range(3):
            place = (points[row, axis] - centre[axis] + half) * scale
            # Written so that NaN is in the first cell.
            cell = 0 if not place > 0.0 else _CELLS - 1 if place >= _CELLS else int(place)
            key |= SPREAD_BITS[cell] << axis
        keys[row] = key

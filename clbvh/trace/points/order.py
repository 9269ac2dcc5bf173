"""Points in a coherent order: neighbours on the device are close together, for the reason that `rays/sort.py` gives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.morton import SPREAD_BITS
from ...support.compiled import compiled
from ...support.counting_sort import order_by_keys
from ...support.host_threads import HostThreads
from ..rays.batch import TreeBox

# Fewer points stay in their order. Whole calls with 1,024, 4,096 and 16,384 points, sorted against unsorted, 2 cores of
# an x86-64 server: 1.07, 0.77, 0.61 near the dragon, 0.92, 0.65, 0.63 anywhere in its box; 1.06, 0.87, 0.81 near the
# bunny, and 1.01, 0.73, 0.80.
LEAST_POINTS = 1 << 12

# Cells along each axis of a cube around the box, 8 bits of a key. Points outside of it count as on its border.
_CELLS = 256
_CUBE_SHARE = 2.0


def find_point_order(points: NDArray[Any], box: TreeBox, threads: HostThreads) -> NDArray[np.int32]:
    """Return (n,) int32: the order in which to cast points; they need not be finite.

    Parameters
    ----------
    points : (n, 3) float, contiguous
    box : TreeBox
    threads : HostThreads
    """
    if len(points) < LEAST_POINTS:
        return np.arange(len(points), dtype=np.int32)
    # A box without size stands for the unit of its coordinates: all points are then on the border of one cell.
    half = _CUBE_SHARE * (float(box.half.max()) or 1.0) / box.scale

    def make_keys(begin: int, end: int, keys: NDArray[np.int32]) -> None:
        _make_keys(points[begin:end], box.centre, half, _CELLS / (2 * half), keys)

    return order_by_keys(len(points), threads, make_keys)


@compiled
def _make_keys(points, centre, half, scale, keys):
    for point in range(len(points)):
        key = 0
        for axis in range(3):
            position = (points[point, axis] - centre[axis] + half) * scale
            # Written so that NaN is in the first cell.
            cell = 0 if not position > 0.0 else _CELLS - 1 if position >= _CELLS else int(position)
            key |= SPREAD_BITS[cell] << axis
        keys[point] = key

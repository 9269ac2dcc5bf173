"""Points on their way to the device: checked, put in a coherent order, and packed as pairs of float32."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...structs import PACKED_POINT
from ..launch import Batch, Call
from ..rays.coherence import KeyOrder
from ..rays.pieces import CHUNK_RAYS, Progress, cut_points
from ..world.tree_box import TreeBox

LOOPS = Loops("points/pack")


def cut_points_of(
    call: Call, dtype: np.dtype, count: int, progress: Progress | None, *, most_points: int = CHUNK_RAYS
) -> Iterator[tuple[int, int]]:
    """Yield the chunks in which a call casts points, of the dtype in which they are packed; see `pieces.cut_points`."""
    return cut_points(count, most_points=call.fit(dtype, min(most_points, CHUNK_RAYS)), progress=progress)


def put_points(call: Call, dtype: np.dtype, count: int, pack: Callable[[int, int, NDArray[np.void]], None]) -> Batch:
    """Put points on the device: `pack` writes a range of them."""
    points = call.fill("points", dtype, count, pack)
    work_group = (call.session.settings.work_group_size, 1)
    return Batch(count, (count, 1), work_group, {"points": points, "point_count": np.int32(count)})


def pack_points(
    call: Call, points: NDArray[Any], masks: NDArray[np.uint32], limits: NDArray[np.float64], order: NDArray[np.int32]
) -> Batch:
    """Put points on the device.

    Parameters
    ----------
    call : Call
    points : (n, 3) float, contiguous
        Finite.
    masks : (n,) or (1,) uint32
        One for each point, or one for all.
    limits : (n,) or (1,) float64
    order : (m,) int32
        Points to put there, by their indices; at least one.
    """

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        given = points, points.itemsize == 8, masks, len(masks) > 1, limits, len(limits) > 1
        LOOPS.pack_points(*given, call.world.box_numbers, order[first:last], packed)

    return put_points(call, PACKED_POINT, len(order), pack)


# Fewer points stay in their order. Whole calls with 1,024, 4,096 and 16,384 points, sorted against unsorted, 2 cores of
# an x86-64 server: 1.07, 0.77, 0.61 near the dragon, 0.92, 0.65, 0.63 anywhere in its box; 1.06, 0.87, 0.81 near the
# bunny, and 1.01, 0.73, 0.80.
LEAST_POINTS = 1 << 12

# Cells along each axis of a cube around the box, 8 bits of a key. Points outside of it count as on its border.
_CELLS = 256
_CUBE_SHARE = 2.0


def find_point_order(points: NDArray[Any], box: TreeBox, order_by_keys: KeyOrder) -> NDArray[np.int32]:
    """Return (n,) int32: the order in which to look points up; they need not be finite.

    Parameters
    ----------
    points : (n, 3) float, contiguous
    box : TreeBox
    order_by_keys : function
    """
    if len(points) < LEAST_POINTS:
        return np.arange(len(points), dtype=np.int32)
    # A box without size stands for the unit of its coordinates: all points are then on the border of one cell.
    half = _CUBE_SHARE * (float(box.half.max()) or 1.0) / box.scale

    def make_keys(begin: int, end: int, keys: NDArray[np.int32]) -> None:
        own = points[begin:end], points.itemsize == 8
        LOOPS.write_keys(*own, box.centre, half, _CELLS / (2 * half), keys)

    return order_by_keys(len(points), make_keys)

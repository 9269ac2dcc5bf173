"""Points on their way to the device: checked, put in a coherent order, and packed as pairs of float32."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...errors import QueryError
from ...structs import PACKED_POINT
from ..launch import Batch, Call
from ..rays.batch import Broadcast, too_far
from ..rays.coherence import KeyOrder
from ..rays.pieces import CHUNK_RAYS, Progress, cut_points
from ..world.tree_box import TreeBox

# A point farther away than this many times half the box's size is moved to that distance, towards the centre. From
# there on, the closest triangle depends on little but the direction: by half of half the size over this number. A
# larger one would cost more in float32: sixteen roundings of it are as much.
FAR_SHARE = 512.0

LOOPS = Loops("points/pack")


def take_points(points: Broadcast, begin: int, end: int, box: TreeBox) -> NDArray[Any]:
    """Return points `begin` to `end`, counted in C order, as loops take them: (n, 3), contiguous.

    Raises
    ------
    QueryError
        A point is not finite, or its local coordinates are not; the message names the first bad one.
    """
    part = points.part(begin, end, points.items.dtype)
    if len(part) < end - begin:  # all points are one
        part = np.broadcast_to(part, (end - begin, 3)).copy()
    if (bad := LOOPS.find_bad(part, _is_double(part), len(part), box.centre, box.scale)) >= 0:
        subject, point = points.subject("points", begin + bad), part[bad]
        if not np.isfinite(point).all():
            raise QueryError(f"{subject} is not finite: {point}")
        raise too_far(subject, point)
    return part


def _is_double(vectors: NDArray[Any]) -> bool:
    return vectors.dtype == np.float64


_MASK_TYPE = np.dtype(np.uint32)

# The mask of points to which every instance is visible that has a bit of its own.
_ALL_VISIBLE = np.array([0xFFFF_FFFF], _MASK_TYPE)
_ALL_VISIBLE.flags.writeable = False


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


def pack_points(call: Call, points: NDArray[Any], masks: NDArray[np.uint32], order: NDArray[np.int32]) -> Batch:
    """Put points on the device.

    Parameters
    ----------
    call : Call
    points : (n, 3) float, contiguous
        Finite.
    masks : (n,) or (1,) uint32
        One for each point, or one for all.
    order : (m,) int32
        Points to put there, by their indices; at least one.
    """
    box = call.world.box
    centre, scale, far = box.centre, box.scale, FAR_SHARE * box.half.max()

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        given = points, _is_double(points), masks, len(masks) > 1
        LOOPS.pack_points(*given, centre, scale, far, order[first:last], packed)

    return put_points(call, PACKED_POINT, len(order), pack)


def take_masks(masks: Broadcast | None, begin: int, end: int) -> NDArray[np.uint32]:
    """Return the masks of points `begin` to `end`, counted in C order: one for each, or (1,) for all.

    Without masks, every instance is visible.
    """
    return _ALL_VISIBLE if masks is None else masks.part(begin, end, _MASK_TYPE)


# Fewer points stay in their order. Whole calls with 1,024, 4,096 and 16,384 points, sorted against unsorted, 2 cores of
# an x86-64 server: 1.07, 0.77, 0.61 near the dragon, 0.92, 0.65, 0.63 anywhere in its box; 1.06, 0.87, 0.81 near the
# bunny, and 1.01, 0.73, 0.80.
LEAST_POINTS = 1 << 12

# Cells along each axis of a cube around the box, 8 bits of a key. Points outside of it count as on its border.
_CELLS = 256
_CUBE_SHARE = 2.0


def find_point_order(points: NDArray[Any], box: TreeBox, order_by_keys: KeyOrder) -> NDArray[np.int32]:
    """Return (n,) int32: the order in which to cast points; they need not be finite.

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
        own = points[begin:end], _is_double(points)
        LOOPS.write_keys(*own, box.centre, half, _CELLS / (2 * half), keys)

    return order_by_keys(len(points), make_keys)

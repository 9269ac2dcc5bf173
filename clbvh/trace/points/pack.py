"""Points on their way to the device: checked, then packed in float32."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import QueryError
from ...structs import PACKED_POINT_LANES
from ...support.compiled import compiled
from ..rays.batch import TreeBox, too_far
from ..rays.broadcast import Broadcast

# A point farther away than this many times half the box's size is moved to that distance, towards the centre. From
# there on, the closest triangle depends on little but the direction: by half of half the size over this number. A
# larger one would cost more in float32: sixteen roundings of it are as much.
FAR_SHARE = 512.0

_ALL_GOOD = -1


def take_points(points: Broadcast, begin: int, end: int, box: TreeBox) -> NDArray[Any]:
    """Return points `begin` to `end`, counted in C order, as compiled functions take them: (n, 3), contiguous.

    Raises
    ------
    QueryError
        A point is not finite, or its local coordinates are not; the message names the first bad one.
    """
    part = points.part(begin, end, points.items.dtype)
    if len(part) < end - begin:  # all points are one
        part = np.broadcast_to(part, (end - begin, 3)).copy()
        part.flags.writeable = False
    bad = _find_bad(part, box.centre, box.scale)
    if bad != _ALL_GOOD:
        subject, point = points.subject("points", begin + bad), part[bad]
        if not np.isfinite(point).all():
            raise QueryError(f"{subject} is not finite: {point}")
        raise too_far(subject, point)
    return part


def pack_points(points: NDArray[Any], box: TreeBox, order: NDArray[np.int32], packed: NDArray[np.void]) -> None:
    """Write points as the device takes them.

    Parameters
    ----------
    points : (n, 3) float, contiguous
        Finite.
    box : TreeBox
    order : (m,) int32
        Points to write, by their indices.
    packed : (m,) `structs.PACKED_POINT`, written
    """
    far = FAR_SHARE * box.half.max()
    _pack(points, order, box.centre, box.scale, far, packed.view(np.float32).reshape(-1, PACKED_POINT_LANES))


@compiled
def _find_bad(points, centre, scale):
    """Return the index of the first point whose local coordinates are not finite, or _ALL_GOOD."""
    for point in range(len(points)):
        for axis in range(3):
            local = (points[point, axis] - centre[axis]) * scale
            # Infinity minus infinity is NaN.
            if local - local != 0.0:
                return point
    return _ALL_GOOD


@compiled
def _pack(points, order, centre, scale, far, packed):
    local = np.empty(3)
    for slot in range(len(order)):
        point = order[slot]
        size = 0.0
        for axis in range(3):
            local[axis] = (points[point, axis] - centre[axis]) * scale
            size = max(size, abs(local[axis]))
        share = far / size if size > far else 1.0
        for axis in range(3):
            packed[slot, axis] = local[axis] * share

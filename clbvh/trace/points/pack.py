"""Points on their way to the device: checked, then packed in float32."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import QueryError
from ...structs import PACKED_POINT_LANES
from ...support.compiled import compiled
from ..rays.batch import TreeBox, index_text

# A point further away than this many times half the box's size is moved to that distance, towards the centre. From
# there on, the closest triangle depends on little but the direction: by half of half the size over this number. A
# larger one would cost more in float32: sixteen roundings of it are as much.
_FAR_SHARE = 512.0


def unit_scale(box: TreeBox) -> np.float32:
    """Return a power of two that scales a box to a size of about 1."""
    return np.float32(math.ldexp(1.0, -math.frexp(float(box.half.max()))[1])) if box.half.any() else np.float32(1.0)


def check_points(points: NDArray[Any], first: int, shape: tuple[int, ...]) -> None:
    """Raise `QueryError` for the first point that is not finite.

    Parameters
    ----------
    points : (n, 3) float
    first : int
        Index of the first one among the user's.
    shape : tuple of int
        Leading shape of the user's array.
    """
    is_good = np.isfinite(points).all(axis=1)
    if not is_good.all():
        bad = int(np.argmin(is_good))
        raise QueryError(f"points[{index_text(first + bad, shape)}] is not finite: {points[bad]}")


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
    _pack(
        points, order, box.centre, _FAR_SHARE * box.half.max(), packed.view(np.float32).reshape(-1, PACKED_POINT_LANES)
    )


@compiled
def _pack(points, order, centre, far, packed):
    for slot in range(len(order)):
        point = order[slot]
        size = 0.0
        for axis in range(3):
            size = max(size, abs(points[point, axis] - centre[axis]))
        scale = far / size if size > far else 1.0
        for axis in range(3):
            packed[slot, axis] = (points[point, axis] - centre[axis]) * scale

"""Points on their way to a scene on the device: packed as pairs of float32, with their masks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import SCENE_POINT_LANES, SCENE_POINT_MASK, SCENE_POINT_POSITION_LOW, SCENE_POINT_SPARE
from ...support.compiled import compiled
from ..rays.batch import TreeBox
from ..rays.broadcast import Broadcast
from .pack import FAR_SHARE

_MASK_TYPE = np.dtype(np.uint32)

# The mask of points to which every instance is visible that has a bit of its own.
_ALL_VISIBLE = np.array([0xFFFF_FFFF], _MASK_TYPE)
_ALL_VISIBLE.flags.writeable = False


def pack_scene_points(
    points: NDArray[Any],
    masks: NDArray[np.uint32],
    box: TreeBox,
    order: NDArray[np.int32],
    packed: NDArray[np.void],
) -> None:
    """Write points as the device takes them.

    Parameters
    ----------
    points : (n, 3) float, contiguous, the scene's coordinates
        Finite.
    masks : (n,) or (1,) uint32
        One for each point, or one for all.
    box : TreeBox
        Around the scene.
    order : (m,) int32
        Points to write, by their indices.
    packed : (m,) `structs.SCENE_POINT`, written
    """
    lanes = packed.view(np.float32).reshape(-1, SCENE_POINT_LANES)
    far = FAR_SHARE * box.half.max()
    _pack(points, masks.view(np.int32), order, box.centre, box.scale, far, lanes, lanes.view(np.int32))


def take_masks(masks: Broadcast | None, begin: int, end: int) -> NDArray[np.uint32]:
    """Return the masks of points `begin` to `end`, counted in C order: one for each, or (1,) for all.

    Without masks, every instance is visible.
    """
    return _ALL_VISIBLE if masks is None else masks.part(begin, end, _MASK_TYPE)


@compiled
def _pack(points, masks, order, centre, scale, far, packed, packed_ints):
    local = np.empty(3)
    for slot in range(len(order)):
        point = order[slot]
        size = 0.0
        for axis in range(3):
            local[axis] = (points[point, axis] - centre[axis]) * scale
            size = max(size, abs(local[axis]))
        share = far / size if size > far else 1.0
        for axis in range(3):
            position = local[axis] * share
            packed[slot, axis] = position
            packed[slot, SCENE_POINT_POSITION_LOW + axis] = position - np.float64(packed[slot, axis])
        packed_ints[slot, SCENE_POINT_MASK] = masks[point] if len(masks) > 1 else masks[0]
        packed[slot, SCENE_POINT_SPARE] = 0.0

"""The closest point of the surface for each point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ..launch import CLOSEST_POINT, Call, Caster
from ..less_memory import cut_smaller_when_full
from ..rays.broadcast import Broadcast
from ..rays.pieces import Progress
from ..room import check_room
from .order import find_point_order
from .pack import pack_points, take_points
from .refine import ClosestPoints, refine_points

# Distance, point and prim_id of a point.
_POINT_BYTES = 36


@cut_smaller_when_full
def find_closest_points(
    caster: Caster, mesh: Mesh, points: Broadcast, progress: Progress | None = None
) -> ClosestPoints:
    """Return the closest points of the surface; see `Tracer.closest_point`."""
    shape, count = points.shape, math.prod(points.shape)
    check_room(count, _POINT_BYTES, "points")
    found = ClosestPoints(np.empty(count), np.empty((count, 3)), np.empty(count, np.int32))
    with caster.open_call() as call:
        for begin, end in call.cut_points(count, progress):
            chunk = take_points(points, begin, end, call.box)
            part = ClosestPoints(found.distance[begin:end], found.point[begin:end], found.prim_id[begin:end])
            _find_chunk(call, mesh, chunk, part)
    return ClosestPoints(found.distance.reshape(shape), found.point.reshape(*shape, 3), found.prim_id.reshape(shape))


def _find_chunk(call: Call, mesh: Mesh, points: NDArray[Any], closest: ClosestPoints) -> None:
    """Write the closest points for a chunk of points, which is cast in a coherent order."""
    order = find_point_order(points, call.box, call.threads)

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        pack_points(points, call.box, order[first:last], packed)

    batch = call.pack_points(len(points), pack)
    with call.cast(CLOSEST_POINT, batch) as prim_id:

        def refine(first: int, last: int) -> None:
            refine_points(points, mesh, call.box, order[first:last], prim_id[first:last], closest)

        call.threads.for_ranges(len(points), refine)

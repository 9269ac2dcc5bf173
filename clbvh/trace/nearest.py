"""Queries about points: the nearest point of the surface, and which side of it a point is on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .caster import Caster, Progress
from .point_order import find_point_order
from .points import POINT, ClosestPoints, check_points, pack_points, refine_points, unit_scale
from .rays import read_rays

_PRIM_ID = np.dtype(np.int32)
_COUNT = np.dtype(np.int32)

# Crossings are counted along this direction. Any will do; one that no mesh is modelled along meets few edges, where
# the traversal has the most to do.
_GENERIC_DIRECTION = np.array([0.374, 0.621, 0.689])


def find_closest(caster: Caster, mesh: Mesh, points: NDArray[Any], progress: Progress | None) -> ClosestPoints:
    """Return the nearest points of the surface; see `Tracer.closest_point`."""
    count = len(points)
    found = ClosestPoints(np.empty(count), np.empty((count, 3)), np.empty(count, np.int32))
    for begin, end in caster.cut(count, progress):
        chunk = np.ascontiguousarray(points[begin:end])
        check_points(chunk, begin)
        order = find_point_order(chunk, caster.box, caster.threads)
        part = ClosestPoints(found.distance[begin:end], found.point[begin:end], found.prim_id[begin:end])
        _find_closest_of_chunk(caster, mesh, chunk, order, part)
    return found


def _find_closest_of_chunk(
    caster: Caster, mesh: Mesh, chunk: NDArray[Any], order: NDArray[np.int32], found: ClosestPoints
) -> None:
    """Find the nearest points of some points, taken in an order, and write them to where the points are."""

    def pack(first: int, last: int, rows: NDArray[np.void]) -> None:
        pack_points(chunk, caster.box, order[first:last], rows)

    caster.upload_rows(POINT, len(chunk), pack)
    with caster.cast("closest_point", len(chunk), _PRIM_ID, unit_scale(caster.box)) as prim_id:

        def refine(first: int, last: int) -> None:
            refine_points(chunk, mesh, caster.box, order[first:last], prim_id[first:last], found)

        caster.threads.for_ranges(len(chunk), refine)


def find_inside(caster: Caster, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
    """Return which points are inside of a closed mesh; see `Tracer.contains`."""
    inside = np.zeros(len(points), np.bool_)
    for begin, end in caster.cut(len(points), progress):
        part = points[begin:end]
        check_points(part, begin)
        rows = np.flatnonzero((np.abs(part - caster.box.centre) <= caster.box.half).all(axis=1))
        batch = read_rays(part[rows], np.broadcast_to(_GENERIC_DIRECTION, (len(rows), 3)), 0.0, np.inf)
        for first, last in caster.ray_chunks(batch):
            with caster.cast("count_hits", last - first, _COUNT, np.int32(np.iinfo(np.int32).max)) as counts:
                inside[begin + rows[first:last]] = counts % 2 == 1
    return inside

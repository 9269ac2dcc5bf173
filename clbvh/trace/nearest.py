"""Queries about points: the nearest point of the surface, and which side of it a point is on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from . import caster as caster_module
from .caster import Caster, Progress
from .points import POINT, ClosestPoints, pack_points, refine_points, unit_scale
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

    def pack(begin: int, end: int, rows: NDArray[np.void]) -> None:
        pack_points(np.ascontiguousarray(points[begin:end]), caster.box, rows, first_row=begin)

    for begin, end in caster.chunks(count, POINT, pack, progress):
        with caster.cast("closest_point", end - begin, _PRIM_ID, unit_scale(caster.box)) as prim_id:

            def refine(first: int, last: int, begin: int = begin, prim_id: NDArray[np.int32] = prim_id) -> None:
                rows = slice(begin + first, begin + last)
                part = ClosestPoints(found.distance[rows], found.point[rows], found.prim_id[rows])
                refine_points(np.ascontiguousarray(points[rows]), mesh, caster.box, prim_id[first:last], part)

            caster.threads.for_ranges(end - begin, refine)
    return found


def find_inside(caster: Caster, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
    """Return which points are inside of a closed mesh; see `Tracer.contains`."""
    inside = np.zeros(len(points), np.bool_)
    for begin in range(0, max(len(points), 1), caster_module.CHUNK_RAYS):
        part = points[begin : begin + caster_module.CHUNK_RAYS]
        if not np.isfinite(part).all():
            bad = int(np.argmin(np.isfinite(part).all(axis=1)))
            raise ValueError(f"points[{begin + bad}] is not finite: {part[bad]}")
        rows = np.flatnonzero((np.abs(part - caster.box.centre) <= caster.box.half).all(axis=1))
        batch = read_rays(part[rows], np.broadcast_to(_GENERIC_DIRECTION, (len(rows), 3)), 0.0, np.inf)
        for first, last in caster.ray_chunks(batch):
            with caster.cast("count_hits", last - first, _COUNT, np.int32(np.iinfo(np.int32).max)) as counts:
                inside[begin + rows[first:last]] = counts % 2 == 1
        if progress is not None and len(part):
            progress(begin + len(part), len(points))
    return inside

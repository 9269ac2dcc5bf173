"""Which points are inside a closed mesh: those from which a ray crosses the surface an odd number of times."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..hits.closest import count_hits
from ..launch import Caster
from ..rays.batch import read_rays
from ..rays.broadcast import Broadcast
from ..rays.pieces import Progress, cut_points
from ..room import check_room
from .pack import take_points

# Directions along which crossings are counted, in this order of preference. Any will do: a direction that no mesh is
# modelled along meets few edges exactly, where the traversal has the most to do.
GENERIC_DIRECTIONS = np.array([[0.374, 0.621, 0.689], [-0.571, 0.277, 0.773]])


def find_inside(caster: Caster, points: Broadcast, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether each point is inside a closed mesh; see `Tracer.contains`."""
    check_room(math.prod(points.shape), 1, "points")
    box, is_inside = caster.box, np.zeros(math.prod(points.shape), np.bool_)
    with caster.open_call():  # refuses a closed tracer, even without points
        pass
    for begin, end in cut_points(len(is_inside), progress=progress):
        chunk = take_points(points, begin, end, box)
        in_box = np.flatnonzero((np.abs((chunk - box.centre) * box.scale) <= box.half).all(axis=1))
        rays, ray_shape = read_rays(chunk[in_box], GENERIC_DIRECTIONS[0], 0.0, np.inf)
        is_inside[begin + in_box] = count_hits(caster, rays, ray_shape, None, None) % 2 == 1
    return is_inside.reshape(points.shape)

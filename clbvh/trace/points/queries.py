"""The queries of points, whatever the tracer's tree is: a mesh, or the instances of a scene.

Owns what is visible to points, and what the answers are where nothing is. `closest_point.py` and `inside.py` answer for
a mesh, `scene_query.py` for a scene.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...structs import NO_PRIM
from ..launch import Caster
from ..rays.batch import read_masks, read_points
from ..rays.broadcast import Broadcast
from ..rays.pieces import Progress
from .closest_point import find_closest_points
from .inside import find_inside
from .refine import ClosestPoints
from .scene_query import (
    find_scene_closest_points,
    find_scene_inside,
    find_scene_signed_distance,
    select_instances,
)


class SeenPoints(NamedTuple):
    """Points, and the instances that are visible to them.

    Attributes
    ----------
    points : Broadcast of float vectors, the file's coordinates
    masks : Broadcast of uint32, or None
        An instance is visible to a point if their masks share a bit; None: to all points.
    instance_ids : (n,) int, or None
        The only instances that are visible at all; None: all of them.
    """

    points: Broadcast
    masks: Broadcast | None
    instance_ids: NDArray[np.integer] | None

    @classmethod
    def read(cls, points: ArrayLike, mask: ArrayLike | None, instance_ids: NDArray[np.integer] | None) -> SeenPoints:
        """Return points with their masks, as the user gives them.

        Raises
        ------
        QueryError
            Wrong shapes, or masks that are no numbers of 32 bits.
        """
        read = read_points(points)
        return cls(read, None if mask is None else read_masks(mask, read.shape, "points"), instance_ids)

    def hidden(self) -> NDArray[np.bool_] | None:
        """Return which points do not see a mesh without instances, in their shape; None: all see it.

        It is instance 0, and every mask but 0 sees it.
        """
        shape = self.points.shape
        if self.instance_ids is not None and 0 not in self.instance_ids:
            return np.ones(shape, np.bool_)
        if self.masks is None:
            return None
        return np.broadcast_to(self.masks.items.reshape(() if self.masks.is_one else shape) == 0, shape)


def closest_points(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> ClosestPoints:
    """Return the closest points of what is visible; see `Tracer.closest_point`."""
    if caster.tree.has_instances:
        with select_instances(caster, seen.instance_ids) as selected:
            return find_scene_closest_points(selected, seen.points, seen.masks, progress)
    found = find_closest_points(caster, caster.tree.mesh, seen.points, progress)
    hidden = seen.hidden()
    if hidden is None:
        return found
    return ClosestPoints(
        np.where(hidden, np.inf, found.distance),
        np.where(hidden[..., None], np.nan, found.point),
        np.where(hidden, np.int32(NO_PRIM), found.prim_id),
    )


def is_contained(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return whether something visible contains each point; see `Tracer.contains`."""
    if caster.tree.has_instances:
        with select_instances(caster, seen.instance_ids) as selected:
            return find_scene_inside(selected, seen.points, seen.masks, progress)
    inside, hidden = find_inside(caster, seen.points, progress), seen.hidden()
    return inside if hidden is None else inside & ~hidden


def signed_distances(caster: Caster, seen: SeenPoints, progress: Progress | None = None) -> NDArray[np.float64]:
    """Return the signed distance to the surface of what is visible; see `Tracer.signed_distance`."""
    if caster.tree.has_instances:
        with select_instances(caster, seen.instance_ids) as selected:
            return find_scene_signed_distance(selected, seen.points, seen.masks, progress)
    distance = closest_points(caster, seen, progress).distance
    return np.where(is_contained(caster, seen), distance, -distance)

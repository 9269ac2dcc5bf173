"""Reads points as the user gives them, what is visible to them, and how far away.

Shapes are checked here, values when they are looked up.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.host.loops import Loops
from ...errors import QueryError
from ..rays.batch import ALL_VISIBLE, Broadcast, find_point_axes, read_lengths, read_masks, read_vectors, too_far
from ..world.tree_box import TreeBox

_LOOPS = Loops("points/pack")

_NOTHING_VISIBLE = np.zeros((), np.uint32)
ANY_DISTANCE = np.array(np.inf)
ANY_DISTANCE.flags.writeable = False


class SeenPoints:
    """Points, and the instances that are visible to them.

    Parameters
    ----------
    points : (..., 3) float32 or float64, the file's coordinates
        With any strides.
    masks : (...,) uint32
        Broadcast to the points: an instance is visible to a point if their masks share a bit.
    instance_ids : (n,) int, or None
        The only instances that are visible at all; None: all of them.
    limits : (...,) float64, the file's unit
        Broadcast to the points: what is farther away than this is not looked for, as far as float32 can tell.

    Attributes
    ----------
    shape : tuple of int
        Leading shape of the points.
    count : int
    """

    def __init__(
        self, points: NDArray[Any], masks: NDArray[np.uint32] = ALL_VISIBLE,
        instance_ids: NDArray[np.integer] | None = None, limits: NDArray[np.float64] = ANY_DISTANCE,
    ) -> None:  # fmt: skip
        self.points, self.masks, self.instance_ids, self.limits = points, masks, instance_ids, limits
        self.shape = points.shape[:-1]
        self.count = math.prod(self.shape)

    @classmethod
    def read(
        cls, points: ArrayLike, mask: ArrayLike | None = None, instance_ids: NDArray[np.integer] | None = None,
        max_distance: ArrayLike = np.inf, name: str = "max_distance",
    ) -> SeenPoints:  # fmt: skip
        """Return points with their masks and limits, as the user gives and names them, without a copy where possible.

        Raises
        ------
        QueryError
            Wrong shapes, masks that are no numbers of 32 bits, or distances below 0.
        """
        vectors = read_vectors(points, "points")
        masks = ALL_VISIBLE if mask is None else read_masks(mask, vectors.shape[:-1], "points")
        return cls(vectors, masks, instance_ids, read_lengths(max_distance, name, vectors.shape[:-1]))

    def take(self, ids: NDArray[np.int64]) -> SeenPoints:
        """Return some of the points, by their numbers in C order."""
        parts = (rows.take(ids).items for rows in (self.rows, self.mask_rows, self.limit_rows))
        points, masks, limits = (np.broadcast_to(part, (len(ids), *part.shape[1:])) for part in parts)
        return SeenPoints(points, masks, self.instance_ids, limits)

    def without_any(self) -> SeenPoints:
        """Return the points where they see nothing."""
        return SeenPoints(self.points, _NOTHING_VISIBLE, limits=self.limits)

    @cached_property
    def rows(self) -> Broadcast:
        """The points in C order, part by part."""
        return Broadcast.to_shape(self.points, 1, self.shape)

    @cached_property
    def mask_rows(self) -> Broadcast:
        """The masks in C order, part by part."""
        return Broadcast.to_shape(self.masks, 0, self.shape)

    @cached_property
    def limit_rows(self) -> Broadcast:
        """The limits in C order, part by part."""
        return Broadcast.to_shape(self.limits, 0, self.shape)

    @cached_property
    def axes(self) -> NDArray[np.int64]:
        """(n, 6) int64: where the host's kernels find the points, see cl/rays/arrays.cl."""
        return find_point_axes(self.points, self.limits, self.masks)


def take_points(rows: Broadcast, begin: int, end: int, box: TreeBox) -> NDArray[Any]:
    """Return points `begin` to `end`, counted in C order, as loops take them: (n, 3), contiguous.

    Raises
    ------
    QueryError
        A point is not finite, or its local coordinates are not; the message names the first bad one.
    """
    part = rows.part(begin, end, rows.items.dtype)
    if len(part) < end - begin:  # all points are one
        part = np.broadcast_to(part, (end - begin, 3)).copy()
    if (bad := _LOOPS.find_bad(part, part.itemsize == 8, len(part), box.as_numbers())) >= 0:
        raise explain_bad_point(rows, begin + bad)
    return part


def explain_bad_point(rows: Broadcast, number: int) -> QueryError:
    """Return the error for a bad point."""
    subject, (point,) = rows.subject("points", number), rows.part(number, number + 1, rows.items.dtype)
    return too_far(subject, point) if np.isfinite(point).all() else QueryError(f"{subject} is not finite: {point}")

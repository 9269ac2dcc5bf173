"""The share of the hemisphere over each point that is open, by rays that are drawn and cast on the device.

A point on a surface is there only to the rounding of its coordinates, and the tracer has the surface in float32. So a
point is lifted along its normal by a bound on both; docs/internals/offsets.md derives it. What float32 rounds inside of
an instance is added on the device (`cl/instances/lift.cl`), which knows the instances around the point.
"""

from __future__ import annotations

import math
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError, QueryError
from ...structs import HEMISPHERE
from ..launch import Batch, Call, Caster, Query
from ..rays.batch import ALL_VISIBLE, Broadcast, broadcast_shape, check_room, read_lengths, read_masks, read_vectors
from ..rays.pieces import Progress
from ..world.surface_arrays import DOUBLE_ROUNDING, FLOAT_ROUNDING
from ..world.tree_box import TreeBox
from .batch import take_points
from .pack import LOOPS, cut_points_of, find_point_order, put_points

AMBIENT_OCCLUSION = Query("ambient_occlusion", "open_counts", np.dtype(np.int32))

# Rays of a launch: between launches Ctrl-C is seen, and drivers of GPUs that draw the screen end long ones. On a
# 2-core x86-64 server it is about a second of work.
_LAUNCH_RAYS = 1 << 22

# Points of a launch, at least, so that every GPU is busy.
_LEAST_POINTS = 1 << 16

_MOST_RAYS = 1 << 24
_MOST_SEED = 0xFFFF_FFFF
_MOST_NUMBER = 1 << 62


def check_sampling(rays: int, seed: int, first_number: int, *, most_rays: int = _MOST_RAYS) -> tuple[int, int, int]:
    """Return the number of rays at each point, the seed, and the number of the first point.

    Raises
    ------
    ConfigError
        One of them is no integer, or out of range.
    """
    numbers = "first_number", first_number, 0, _MOST_NUMBER
    for name, value, least, most in (("rays", rays, 1, most_rays), ("seed", seed, 0, _MOST_SEED), numbers):
        is_integer = isinstance(value, Integral) and not isinstance(value, bool)
        if not (is_integer and least <= value <= most):
            raise ConfigError(f"{name} must be an integer from {least} to {most}, not {value}")
    return int(rays), int(seed), int(first_number)


def find_open_shares(
    caster: Caster, hemispheres: Hemispheres, rays: int, seed: int, first_number: int, progress: Progress | None = None
) -> tuple[NDArray[np.float64], int]:
    """Return the share of rays over each point that meet nothing, and how many points have no normal.

    See `Tracer.ambient_occlusion`.
    """
    count = math.prod(hemispheres.shape)
    check_room(count, 8, "points")
    shares = np.empty(count)
    lost_count = 0

    def cast(call: Call) -> None:
        nonlocal lost_count
        lost_count = 0
        most_points = max(_LEAST_POINTS, _LAUNCH_RAYS // rays)
        for begin, end in cut_points_of(call, HEMISPHERE, count, progress, most_points=most_points):
            rows = hemispheres.take(begin, end, call.world.box)
            order = find_point_order(rows.points, call.world.box, call.order_by_keys)
            batch = pack_hemispheres(call, rows, order, first_number + begin)
            open_counts = np.zeros(end - begin, np.int64)
            step = max(1, _LAUNCH_RAYS // (end - begin))
            for first_ray in range(0, rays, step):
                ray_count = min(step, rays - first_ray)
                with call.cast(
                    AMBIENT_OCCLUSION, batch,
                    first_ray=np.int32(first_ray), ray_count=np.int32(ray_count), seed=np.uint32(seed),
                ) as found:  # fmt: skip
                    open_counts[order] += found
            # Every mask but 0 sees a mesh without instances, which the device does not check.
            shares[begin:end] = np.where(rows.masks == 0, 1.0, open_counts / rays)
            lost_count += rows.lost_count

    caster.run(cast)
    return shares.reshape(hemispheres.shape), lost_count


# Roundings in the user's own dtype between a point on the surface and its coordinates: seven for a point that is made
# of three corners, and one for those.
_POINT_ROUNDINGS = 8

# Roundings of float32 between a point and the t of a triangle: the 40 of docs/internals/offsets.md, and room for the
# rounding of the corners and of the normal that the user gives.
_SURFACE_ROUNDINGS = 64

# Relative error of a position that the device has as a pair of float32.
_PAIR_ROUNDING = 2.0**-45

_FLOAT64 = np.dtype(np.float64)


class Hemispheres(NamedTuple):
    """Points, and the half-spaces into which their rays go, as the user gave them.

    Attributes
    ----------
    points, normals : Broadcast of float32 or float64 vectors, the file's coordinates
        Normals have any length; those that are zero or have a NaN are no directions.
    max_distance : Broadcast of float64, the file's units
        Length of the rays.
    masks : Broadcast of uint32
        The instances of a scene that are visible.
    offset : float, the file's units
        By which points are lifted off the surface beside the bound on rounding.
    """

    points: Broadcast
    normals: Broadcast
    max_distance: Broadcast
    masks: Broadcast
    offset: float

    @classmethod
    def read(
        cls, points: ArrayLike, normals: ArrayLike, max_distance: ArrayLike, mask: ArrayLike | None, offset: float
    ) -> Hemispheres:
        """Return them without a copy where possible.

        Raises
        ------
        QueryError
            Wrong shapes, shapes that do not broadcast, masks that are no numbers of 32 bits, or a length or an offset
            that is negative or NaN.
        """
        vectors = read_vectors(points, "points"), read_vectors(normals, "normals")
        try:
            shape = broadcast_shape(vectors[0].shape[:-1], vectors[1].shape[:-1])
        except ValueError:
            raise QueryError(
                "points and normals must have shapes that broadcast against each other, "
                f"not {vectors[0].shape} and {vectors[1].shape}"
            ) from None
        if not (np.ndim(offset) == 0 and 0.0 <= offset < np.inf):
            raise QueryError(f"offset must be a number from 0, not {offset}")
        return cls(
            Broadcast.to_shape(vectors[0], 1, shape),
            Broadcast.to_shape(vectors[1], 1, shape),
            Broadcast.to_shape(read_lengths(max_distance, "max_distance", shape), 0, shape),
            Broadcast.to_shape(ALL_VISIBLE if mask is None else read_masks(mask, shape, "points"), 0, shape),
            float(offset),
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape that points and normals are broadcast to."""
        return self.points.shape

    def take(self, begin: int, end: int, box: TreeBox) -> HemisphereRows:
        """Return a range of them, counted in C order, as loops take them.

        Points without a direction see nothing: their masks become 0.

        Raises
        ------
        QueryError
            A point is not finite or too far away, or a normal is infinite; the message names the first.
        """
        points = take_points(self.points, begin, end, box).astype(_FLOAT64, copy=False)
        normals, masks = self.normals.part(begin, end, _FLOAT64), self.masks.part(begin, end, self.masks.items.dtype)
        longest = np.abs(normals).max(axis=1)
        if (is_bad := np.isinf(longest)).any():
            bad = int(is_bad.argmax())
            raise QueryError(f"{self.normals.subject('normals', begin + bad)} is not finite: {normals[bad]}")
        is_lost = ~(longest > 0.0)  # written so that NaN is lost, too
        lost_count = int(np.broadcast_to(is_lost, end - begin).sum())
        if lost_count:
            normals, masks = np.where(is_lost[:, None], 1.0, normals), np.where(is_lost, np.uint32(0), masks)
        rounding = FLOAT_ROUNDING if self.points.items.dtype == np.float32 else DOUBLE_ROUNDING
        return HemisphereRows(
            points, normals, self.max_distance.part(begin, end, _FLOAT64), masks, _POINT_ROUNDINGS * rounding,
            self.offset, lost_count,
        )  # fmt: skip


class HemisphereRows(NamedTuple):
    """Points and their half-spaces in contiguous arrays; an array with a single row holds it for all.

    Attributes
    ----------
    points, normals : (n, 3) or (1, 3) float64, the file's coordinates
    max_distance : (n,) or (1,) float64
    masks : (n,) or (1,) uint32
    rounding : float
        Bound on the relative error of the points' coordinates.
    offset : float
    lost_count : int
        Points without a direction.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    max_distance: NDArray[np.float64]
    masks: NDArray[np.uint32]
    rounding: float
    offset: float
    lost_count: int


def pack_hemispheres(call: Call, rows: HemisphereRows, order: NDArray[np.int32], first_number: int) -> Batch:
    """Put points on the device.

    Parameters
    ----------
    call : Call
    rows : HemisphereRows
    order : (m,) int32
        Points to put there, by their indices.
    first_number : int
        The number of the point with index 0; samples depend on a point's number, and not on the order.
    """
    world = call.world
    # Over the surface of a lone shape, which the device has in float32, they are lifted here, over others there.
    surface_rounding = _SURFACE_ROUNDINGS * world.arrays.rounding if world.is_lone else 0.0
    pair_rounding = 0.0 if world.is_lone else _PAIR_ROUNDING * float(world.box.half.max())
    arrays: list[NDArray[Any]] = [rows.points, rows.normals, rows.max_distance, rows.masks]
    each_row = sum(1 << bit for bit, array in enumerate(arrays) if len(array) > 1)

    def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
        LOOPS.pack_hemispheres(
            *arrays, each_row, rows.rounding, rows.offset, first_number, world.box_numbers, surface_rounding,
            pair_rounding, order[first:last], packed,
        )  # fmt: skip

    return put_points(call, HEMISPHERE, len(order), pack)

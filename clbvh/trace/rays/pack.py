"""Rays on their way to the device: in the tree's local coordinates in float64, then packed in float32.

The device sees meshes and directions of about one size, whatever the user's unit: the mesh is scaled by a power of two,
and so is each direction, to a longest component from 1 to 2. Powers of two round nothing, so that a mesh and its rays
give the same hits at every size.

A ray that starts far from a small mesh would lose the mesh in the rounding of its origin. So a distant origin is first
advanced along the ray to just before the box. A ray that misses the box is given an empty interval, which ends its
traversal at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import QueryError
from ...structs import (
    EXACT_RAY,
    EXACT_RAY_DIRECTION,
    EXACT_RAY_LANES,
    PACKED_RAY,
    PACKED_RAY_DIRECTION,
    PACKED_RAY_LANES,
    PACKED_RAY_T_MAX,
    PACKED_RAY_T_MIN,
    RAY_LOW,
    RAY_LOW_DIRECTION,
    RAY_LOW_LANES,
)
from ...support.compiled import compiled
from ...support.loop_functions import exponent_of, power_of_two, prefetch, times_power_of_two
from ..world.tree_box import TreeBox
from .batch import Broadcast, RayBatch, RayRows, row_step, too_far

# The powers of two with exponents up to this, times the scale of any mesh, are normal numbers.
_MOST_FAST_EXPONENT = 400

# An origin within this many times half the box's size is not advanced: float32 rounds by 2^-21 of that there, and a
# ray takes 9 ns instead of 17 on a 2-core x86-64 server.
NEAR_SHARE = 8.0

# The box is grown by these shares of its size and of the origin's distance before a ray is said to miss it: far more
# than float64 rounds, and nothing to the device.
_BOX_SLACK = 2.0**-20
_DISTANCE_SLACK = 2.0**-48

# An origin is advanced by a whole number of steps: this share of the box's size, rounded down to a power of two. So a
# point on a grid stays on it, and a ray exactly through a vertex still meets it exactly.
_STEP_SHARE = 0.25
_WHOLE_STEPS = 2.0**60

# An advance leaves 2^-53 of an origin's distance, so that float64's farthest origin comes near in 20.
_MOST_ADVANCES = 32

# Prefetch distance in rays, for rays in another order than their own. A million take 7 to 9 ms on two cores instead of
# 24; 16 and 40 perform alike.
_PREFETCH_RAYS = 40

# What `write_packed` returns where no ray is bad.
ALL_GOOD = -1
_NOT_SHARED = -2

# No `lows`.
NO_LOWS = np.empty((0, RAY_LOW_LANES), np.float32)

# Origins that are compared before rays are packed as those of one camera.
_SAMPLED_ORIGINS = 16

# The mask of rays that see every instance.
ALL_VISIBLE = np.uint32(0xFFFFFFFF)


class _Ray(NamedTuple):
    """One ray in float64, in local coordinates; its direction may have any length."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    t_min: float
    t_max: float


def pack_rays(
    batch: RayBatch,
    rays: RayRows,
    box: TreeBox,
    packed: NDArray[np.void],
    *,
    order: NDArray[np.int32] | None = None,
    first_ray: int = 0,
    lows: NDArray[np.void] | None = None,
    shared_low: NDArray[np.void] | None = None,
) -> bool:
    """Write rays as the device takes them. They are scaled, and some are advanced: their t is not the user's.

    Parameters
    ----------
    batch : RayBatch
        For messages: the rays as the user gave them.
    rays : RayRows
        A part of the batch.
    box : TreeBox
    packed : (n,) `structs.PACKED_RAY`, written
    order : (n,) int32, optional
        Rays to write, by their indices in the part; all in their own order without it.
    first_ray : int, optional
        Index of the part's first ray in the batch.
    lows : (n,) `structs.RAY_LOW` or `structs.EXACT_RAY`, optional, written
        For the rays of a scene, or of a world that spans scales.
    shared_low : (1,) `structs.RAY_LOW`, optional
        Instead of `lows`, from `find_shared_low`.

    Returns
    -------
    bool
        False if float32 has rounded something else off the origin of a ray than `shared_low` says: then the rays are
        to be packed again, with `lows`.

    Raises
    ------
    QueryError
        A value is not finite, a direction has length zero, or an origin's distance in sizes of the mesh is beyond
        float64; the message names the first bad ray.
    """
    low_lanes = NO_LOWS if lows is None else _as_lanes(lows)
    shared_lanes = NO_LOWS if shared_low is None else _as_lanes(shared_low)
    bad = write_packed(rays, box, order, _as_lanes(packed), low_lanes, shared_lanes)
    if bad == _NOT_SHARED:
        return False
    if bad != ALL_GOOD and order is not None:
        # In another order, it need not be the first bad ray.
        whole = np.empty((int(order.max()) + 1, PACKED_RAY_LANES), np.float32)
        bad = write_packed(rays, box, None, whole, NO_LOWS, NO_LOWS)
    if bad != ALL_GOOD:
        raise explain_bad_ray(batch, first_ray + bad)
    if lows is not None:
        lows["mask"] = ALL_VISIBLE if batch.mask is None else _masks_of(batch.mask, first_ray, order, len(packed))
    return True


def find_shared_low(
    batch: RayBatch, box: TreeBox, begin: int, end: int, *, reads_direction: bool
) -> NDArray[np.void] | None:
    """Return the `structs.RAY_LOW` that rays `begin` to `end` share, (1,), or None if a sample says that they do not.

    Parameters
    ----------
    batch : RayBatch
    box : TreeBox
    begin, end : int
    reads_direction : bool
        Whether the device reads the low parts of directions.

    Raises
    ------
    QueryError
        As `pack_rays`, for the first ray.
    """
    if not (batch.mask is None or batch.mask.is_one):
        return None
    # Scaling by a power of two leaves nothing of a direction in float32 to be rounded off.
    if reads_direction and batch.directions.items.dtype != np.float32:
        return None
    if not batch.origins.is_one:
        sample = batch.origins.take(np.linspace(begin, end - 1, _SAMPLED_ORIGINS).astype(np.int64)).items
        if (sample != sample[0]).any():
            return None
    packed, low = np.empty(1, PACKED_RAY), np.zeros(1, RAY_LOW)
    pack_rays(batch, batch.part(begin, begin + 1), box, packed, first_ray=begin, lows=low)
    low["direction"] = 0.0
    return low


def _as_lanes(items: NDArray[np.void]) -> NDArray[np.floating]:
    lane = np.dtype(np.float64 if items.dtype == EXACT_RAY else np.float32)
    # Not by `view`, which takes 2 us for structs.
    return np.ndarray((len(items), items.dtype.itemsize // lane.itemsize), lane, items)


def _masks_of(masks: Broadcast, first_ray: int, order: NDArray[np.int32] | None, count: int) -> NDArray[np.uint32]:
    """Return the masks of rays that are packed, (n,) or (1,)."""
    if masks.is_one:
        return masks.items
    if order is None:
        return masks.part(first_ray, first_ray + count, masks.items.dtype)
    return masks.take(first_ray + order.astype(np.int64)).items


def explain_bad_ray(batch: RayBatch, ray_id: int) -> QueryError:
    """Return the error for a bad ray."""
    rays = batch.part(ray_id, ray_id + 1)
    origin, direction = rays.origins[0], rays.directions[0]
    subjects = batch.origins.subject("origins", ray_id), batch.directions.subject("directions", ray_id)
    for subject, values in zip(subjects, (origin, direction), strict=True):
        if not np.isfinite(values).all():
            return QueryError(f"{subject} is not finite: {values}")
    if direction.any():
        return too_far(subjects[0], origin)
    return QueryError(f"{subjects[1]} has length zero")


@compiled
def write_packed(batch, box, order, packed, lows, shared):
    """Write rays as `pack_rays`; return the index of the first bad one that is met, or ALL_GOOD, or _NOT_SHARED."""
    origins, directions, t_mins, t_maxs = batch.origins, batch.directions, batch.t_min, batch.t_max
    half, scale = box.half, box.scale
    size = max(half[0], half[1], half[2])
    near = NEAR_SHARE * size
    centre_x, centre_y, centre_z = box.centre[0], box.centre[1], box.centre[2]
    each_t_min, each_t_max = len(t_mins) > 1, len(t_maxs) > 1
    origin_step, direction_step = row_step(origins), row_step(directions)
    if len(packed) > 0:
        t_min, t_max = t_mins[0], t_maxs[0]
    for slot in range(len(packed)):
        ray = slot
        if order is not None:
            ray = np.int64(order[slot])
            # Both ends of the row: it may cross a cache line.
            coming = 3 * np.int64(order[min(slot + _PREFETCH_RAYS, len(packed) - 1)])
            prefetch(origins, coming * origin_step)
            prefetch(origins, coming * origin_step + 2)
            prefetch(directions, coming * direction_step)
            prefetch(directions, coming * direction_step + 2)
        origin_id, direction_id = ray * origin_step, ray * direction_step
        x, y, z = origins[origin_id, 0] - centre_x, origins[origin_id, 1] - centre_y, origins[origin_id, 2] - centre_z
        x, y, z = x * scale, y * scale, z * scale
        dx, dy, dz = (
            np.float64(directions[direction_id, 0]),
            np.float64(directions[direction_id, 1]),
            np.float64(directions[direction_id, 2]),
        )
        longest = max(abs(dx), abs(dy), abs(dz))
        if each_t_min:
            t_min = t_mins[ray]
        if each_t_max:
            t_max = t_maxs[ray]
        exponent = exponent_of(longest)
        total = dx + dy + dz
        # The short way. Written so that NaN and infinity do not take it.
        if (
            longest > 0.0 and abs(exponent) <= _MOST_FAST_EXPONENT and total == total
            and abs(x) <= near and abs(y) <= near and abs(z) <= near
        ):  # fmt: skip
            shrink, stretch = power_of_two(-exponent), power_of_two(exponent) * scale
            _write(
                packed, lows, slot,
                _Ray(x, y, z, dx * shrink, dy * shrink, dz * shrink, t_min * stretch, t_max * stretch),
            )  # fmt: skip
            if len(shared) > 0 and not _has_low(packed, slot, x, y, z, shared):
                return _NOT_SHARED
            continue
        # Infinity minus infinity is NaN, and so is anything with NaN.
        is_finite = (dx - dx) + (dy - dy) + (dz - dz) + (x - x) + (y - y) + (z - z) == 0.0
        if not (is_finite and longest > 0.0):
            return ray
        if len(shared) > 0:
            # The rays of a camera that is far away begin in different points.
            return _NOT_SHARED
        _write_advanced(packed, lows, slot, _Ray(x, y, z, dx, dy, dz, t_min, t_max), exponent, box)
    return ALL_GOOD


@compiled
def _write(packed, lows, slot, ray):
    packed[slot, 0], packed[slot, 1], packed[slot, 2] = ray.x, ray.y, ray.z
    packed[slot, PACKED_RAY_T_MIN] = ray.t_min
    packed[slot, PACKED_RAY_DIRECTION] = ray.dx
    packed[slot, PACKED_RAY_DIRECTION + 1] = ray.dy
    packed[slot, PACKED_RAY_DIRECTION + 2] = ray.dz
    packed[slot, PACKED_RAY_T_MAX] = ray.t_max
    if len(lows) > 0:
        _write_low(packed, lows, slot, ray)


@compiled
def _write_low(packed, lows, slot, ray):
    """Write what float32 has rounded off a ray of a scene, or, into an `EXACT_RAY`, all of it."""
    if lows.shape[1] == EXACT_RAY_LANES:
        lows[slot, 0], lows[slot, 1], lows[slot, 2] = ray.x, ray.y, ray.z
        lows[slot, EXACT_RAY_DIRECTION] = ray.dx
        lows[slot, EXACT_RAY_DIRECTION + 1] = ray.dy
        lows[slot, EXACT_RAY_DIRECTION + 2] = ray.dz
        return
    lows[slot, 0] = ray.x - np.float64(packed[slot, 0])
    lows[slot, 1] = ray.y - np.float64(packed[slot, 1])
    lows[slot, 2] = ray.z - np.float64(packed[slot, 2])
    lows[slot, RAY_LOW_DIRECTION] = ray.dx - np.float64(packed[slot, PACKED_RAY_DIRECTION])
    lows[slot, RAY_LOW_DIRECTION + 1] = ray.dy - np.float64(packed[slot, PACKED_RAY_DIRECTION + 1])
    lows[slot, RAY_LOW_DIRECTION + 2] = ray.dz - np.float64(packed[slot, PACKED_RAY_DIRECTION + 2])


@compiled
def _has_low(packed, slot, x, y, z, shared):
    """Say whether float32 has rounded off an origin what all rays share."""
    return (
        np.float32(x - np.float64(packed[slot, 0])) == shared[0, 0]
        and np.float32(y - np.float64(packed[slot, 1])) == shared[0, 1]
        and np.float32(z - np.float64(packed[slot, 2])) == shared[0, 2]
    )


@compiled(error_model="numpy")
def _write_advanced(packed, lows, slot, ray, exponent, box):
    """Write a ray with its direction divided by 2^exponent and its origin close to the box."""
    half, size = box.half, max(box.half[0], box.half[1], box.half[2])
    x, y, z = ray.x, ray.y, ray.z
    dx, dy = times_power_of_two(ray.dx, -exponent), times_power_of_two(ray.dy, -exponent)
    dz = times_power_of_two(ray.dz, -exponent)
    stretch = exponent + exponent_of(box.scale)
    t_min, t_max = times_power_of_two(ray.t_min, stretch), times_power_of_two(ray.t_max, stretch)
    near, step = NEAR_SHARE * size, times_power_of_two(_STEP_SHARE, exponent_of(size))
    for _ in range(_MOST_ADVANCES):
        if abs(x) <= near and abs(y) <= near and abs(z) <= near:
            _write(packed, lows, slot, _Ray(x, y, z, dx, dy, dz, t_min, t_max))
            return
        # The interval inside the box. Written so that NaN is a miss.
        slack = _BOX_SLACK * size + (_DISTANCE_SLACK * abs(x) + _DISTANCE_SLACK * abs(y) + _DISTANCE_SLACK * abs(z))
        t_near, t_far = _clip(x, dx, half[0] + slack, 0.0, t_max)
        t_near, t_far = _clip(y, dy, half[1] + slack, t_near, t_far)
        t_near, t_far = _clip(z, dz, half[2] + slack, t_near, t_far)
        if not (t_near <= t_far and t_far >= t_min):
            break
        # A t this large is a whole number of steps, and their number may be beyond float64.
        advance = np.floor(t_near / step) * step if t_near < _WHOLE_STEPS else t_near
        x, y, z = x + advance * dx, y + advance * dy, z + advance * dz
        t_min, t_max = max(t_min - advance, 0.0), t_max - advance
    _write(packed, lows, slot, _Ray(0.0, 0.0, 0.0, dx, dy, dz, 0.0, -1.0))


@compiled(error_model="numpy")
def _clip(origin, direction, half, t_near, t_far):
    """Narrow an interval of a ray to the part between -half and half on one axis."""
    if direction == 0.0:
        return (t_near, t_far) if abs(origin) <= half else (np.inf, -np.inf)
    inverse = 1.0 / direction
    middle, width = -origin * inverse, half * abs(inverse)
    return max(t_near, middle - width), min(t_far, middle + width)

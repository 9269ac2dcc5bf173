"""Rays on their way to the device: moved to the tree's box in float64, then packed in float32.

A ray that starts far from a small mesh would lose the mesh in the rounding of its origin. So a distant origin is first
advanced along the ray to just before the box. A ray that misses the box is given an empty interval, which ends its
traversal at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import QueryError
from ...structs import PACKED_RAY_DIRECTION, PACKED_RAY_LANES, PACKED_RAY_T_MAX, PACKED_RAY_T_MIN
from ...support.compiled import compiled
from ...support.prefetch import prefetch
from .batch import RayBatch, TreeBox, index_text

# Directions with a longest component outside of this range are scaled by a power of two: their squares would not fit
# float32.
_SHORT, _LONG = 2.0**-40, 2.0**40

# An origin within this many times half the box's size is not advanced: float32 rounds by 2^-21 of that there, and a
# ray takes 9 ns instead of 17 on a 2-core x86-64 server.
_NEAR_SHARE = 8.0

# The box is grown by these shares of its size and of the origin's distance before a ray is said to miss it: far more
# than float64 rounds, and nothing to the device.
_BOX_SLACK = 2.0**-20
_DISTANCE_SLACK = 2.0**-48

# An origin is advanced by a whole number of steps. A step is a power of two, about a quarter of the box's size, so
# that a point on a grid stays on it, and a ray exactly through a vertex still meets it exactly. The constant is the
# difference of the exponents of the box and of the step.
_STEP_EXPONENT = 2

# Prefetch distance in rays, for rays in another order than their own. A million take 7 to 9 ms on two cores instead of
# 24; 16 and 40 perform alike.
_PREFETCH_RAYS = 40

_ALL_GOOD = -1


class _Ray(NamedTuple):
    """One ray in float64, relative to the centre of the box."""

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
    box: TreeBox,
    packed: NDArray[np.void],
    *,
    order: NDArray[np.int32] | None = None,
    first_ray: int = 0,
    shape: tuple[int, ...] = (),
) -> None:
    """Write rays as the device takes them. Some are advanced or scaled, so their t is not the user's.

    Parameters
    ----------
    batch : RayBatch
        Contiguous, from `RayBatch.part`.
    box : TreeBox
    packed : (n,) `structs.PACKED_RAY`, written
    order : (n,) int32, optional
        Rays to write, by their indices in the batch; all in their own order without it.
    first_ray : int, optional
        Index of the batch's first ray among the user's, for messages.
    shape : tuple of int, optional
        Leading shape of the user's arrays, for messages.

    Raises
    ------
    QueryError
        A value is not finite, or a direction has length zero; the message names the first bad ray.
    """
    lanes = packed.view(np.float32).reshape(-1, PACKED_RAY_LANES)
    bad = _pack(batch, box, order, lanes)
    if bad != _ALL_GOOD and order is not None:
        # In another order, it need not be the first bad one.
        bad = _pack(batch, box, None, np.empty((batch.ray_count, PACKED_RAY_LANES), np.float32))
    if bad != _ALL_GOOD:
        raise _explain(batch, bad, index_text(first_ray + bad, shape))


def _explain(batch: RayBatch, ray_id: int, index: str) -> QueryError:
    """Return the error for a bad ray."""
    for name, values in (("origins", batch.origins), ("directions", batch.directions)):
        if not np.isfinite(values[ray_id]).all():
            return QueryError(f"{name}[{index}] is not finite: {values[ray_id]}")
    return QueryError(f"directions[{index}] has length zero")


@compiled
def scale_exponent(longest):
    """Return the power of two by which a direction with this longest component is divided: 0 for most."""
    if longest < _SHORT or longest > _LONG:
        return math.frexp(longest)[1]
    return 0


@compiled
def _pack(batch, box, order, packed):
    """Write the rays; return the index of the first bad one that is met, or _ALL_GOOD."""
    origins, directions, t_mins, t_maxs = batch.origins, batch.directions, batch.t_min, batch.t_max
    half = box.half
    size = max(half[0], half[1], half[2])
    near = _NEAR_SHARE * size
    centre_x, centre_y, centre_z = box.centre[0], box.centre[1], box.centre[2]
    each_t_min, each_t_max = len(t_mins) > 1, len(t_maxs) > 1
    if len(origins) > 0:
        t_min, t_max = t_mins[0], t_maxs[0]
    for slot in range(len(packed)):
        ray = slot
        if order is not None:
            ray = np.int64(order[slot])
            # Both ends of the row: it may cross a cache line.
            coming = 3 * np.int64(order[min(slot + _PREFETCH_RAYS, len(packed) - 1)])
            prefetch(origins, coming)
            prefetch(origins, coming + 2)
            prefetch(directions, coming)
            prefetch(directions, coming + 2)
        x, y, z = origins[ray, 0] - centre_x, origins[ray, 1] - centre_y, origins[ray, 2] - centre_z
        dx, dy, dz = np.float64(directions[ray, 0]), np.float64(directions[ray, 1]), np.float64(directions[ray, 2])
        size_x, size_y, size_z = abs(dx), abs(dy), abs(dz)
        longest = max(size_x, size_y, size_z)
        if each_t_min:
            t_min = t_mins[ray]
        if each_t_max:
            t_max = t_maxs[ray]
        # The short way. Written so that NaN and infinity do not take it.
        if (
            longest >= _SHORT and size_x <= _LONG and size_y <= _LONG and size_z <= _LONG
            and abs(x) <= near and abs(y) <= near and abs(z) <= near
        ):  # fmt: skip
            _write(packed, slot, _Ray(x, y, z, dx, dy, dz, t_min, t_max))
            continue
        # Infinity minus infinity is NaN, and so is anything with NaN.
        finite = (dx - dx) + (dy - dy) + (dz - dz) == 0.0
        for axis in range(3):
            finite &= origins[ray, axis] - origins[ray, axis] == 0.0
        if not (finite and longest > 0.0):
            return ray
        _write_moved(packed, slot, _Ray(x, y, z, dx, dy, dz, t_min, t_max), longest, half)
    return _ALL_GOOD


@compiled
def _write(packed, slot, ray):
    packed[slot, 0], packed[slot, 1], packed[slot, 2] = ray.x, ray.y, ray.z
    packed[slot, PACKED_RAY_T_MIN] = ray.t_min
    packed[slot, PACKED_RAY_DIRECTION] = ray.dx
    packed[slot, PACKED_RAY_DIRECTION + 1] = ray.dy
    packed[slot, PACKED_RAY_DIRECTION + 2] = ray.dz
    packed[slot, PACKED_RAY_T_MAX] = ray.t_max


@compiled(error_model="numpy")
def _write_moved(packed, slot, ray, longest, half):
    """Write a ray with a direction of moderate length and an origin close to the box.

    `longest` is the longest component of the direction, `half` the half size of the box.
    """
    x, y, z, dx, dy, dz, t_min, t_max = ray
    size = max(half[0], half[1], half[2])
    exponent = scale_exponent(longest)
    if exponent != 0:
        dx, dy, dz = math.ldexp(dx, -exponent), math.ldexp(dy, -exponent), math.ldexp(dz, -exponent)
        longest = math.ldexp(longest, -exponent)
        t_min, t_max = math.ldexp(t_min, exponent), math.ldexp(t_max, exponent)
    near = _NEAR_SHARE * size
    if abs(x) <= near and abs(y) <= near and abs(z) <= near:
        _write(packed, slot, _Ray(x, y, z, dx, dy, dz, t_min, t_max))
        return

    # The interval inside the box. Written so that NaN is a miss.
    slack = _BOX_SLACK * size + _DISTANCE_SLACK * (abs(x) + abs(y) + abs(z))
    t_near, t_far = _clip(x, dx, half[0] + slack, 0.0, t_max)
    t_near, t_far = _clip(y, dy, half[1] + slack, t_near, t_far)
    t_near, t_far = _clip(z, dz, half[2] + slack, t_near, t_far)
    if not (t_near <= t_far and t_far >= t_min):
        _write(packed, slot, _Ray(0.0, 0.0, 0.0, dx, dy, dz, 0.0, -1.0))
        return
    step = math.ldexp(1.0, math.frexp(size)[1] - math.frexp(longest)[1] - _STEP_EXPONENT)
    advance = np.floor(t_near / step) * step
    x, y, z = x + advance * dx, y + advance * dy, z + advance * dz
    _write(packed, slot, _Ray(x, y, z, dx, dy, dz, max(t_min - advance, 0.0), t_max - advance))


@compiled(error_model="numpy")
def _clip(origin, direction, half, t_near, t_far):
    """Narrow an interval of a ray to the part between -half and half on one axis."""
    if direction == 0.0:
        return (t_near, t_far) if abs(origin) <= half else (np.inf, -np.inf)
    inverse = 1.0 / direction
    middle, width = -origin * inverse, half * abs(inverse)
    return max(t_near, middle - width), min(t_far, middle + width)

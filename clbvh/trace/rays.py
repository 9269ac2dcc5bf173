"""Rays on their way to the device: checked, moved to the scene's box in float64, and packed in float32.

A ray that starts far from a small mesh would lose the mesh in the rounding of its origin. So an origin that is far
away is first advanced along the ray to just before the box. If the ray misses the box it is given an empty interval:
the device has no work with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ..simd import prefetch
from ..tree import Bvh

# A packed ray as 4-byte lanes.
_RAY_LANES = 8
_T_MIN_LANE = 3
_DIRECTION_LANE = 4
_T_MAX_LANE = 7

# Directions whose longest component is outside of these are scaled by a power of two: their squares would not fit
# float32.
_SHORT, _LONG = 2.0**-40, 2.0**40

# An origin within this many times half the box's size is left where it is: float32 rounds by 2^-21 of that there,
# and a ray takes 9 ns instead of 17 on a 2-core x86-64 server.
_NEAR_SHARE = 8.0

# The box is grown by these shares of its size, and of the distance of the ray's origin, before it is decided that a
# ray misses it: far more than float64 rounds, and nothing to the device.
_BOX_SLACK = 2.0**-20
_DISTANCE_SLACK = 2.0**-48

# An origin is advanced by whole steps of a power of two, about a quarter of the box's size: so what lies on a grid
# stays on it, and a ray that runs exactly through a vertex still does. The number is how far the step's exponent is
# below the box's.
_STEP_EXPONENT = 2

_ALL_GOOD = -1

# Rays in another order are asked for so many ahead: a million take 7 to 9 ms on two cores instead of 24; 16 and 40 are
# alike.
_AHEAD = 40

# Rays are taken as they come.
GIVEN_ORDER = np.empty(0, np.int32)


@dataclass(frozen=True, eq=False)
class RayBatch:
    """Rays whose shapes are right and whose values are not checked yet.

    Attributes
    ----------
    origins, directions : (n, 3) float32 or float64
    t_min, t_max : (n,) or (1,) float64
    """

    origins: NDArray[Any]
    directions: NDArray[Any]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.origins)

    def take(self, rows: NDArray[np.int64]) -> RayBatch:
        """Return some of the rays, by their numbers."""
        return RayBatch(
            self.origins[rows],
            self.directions[rows],
            self.t_min if len(self.t_min) == 1 else self.t_min[rows],
            self.t_max if len(self.t_max) == 1 else self.t_max[rows],
        )

    def part(self, begin: int, end: int) -> RayBatch:
        """Return some of the rays, contiguous; both arrays have the same dtype."""
        dtype = np.result_type(self.origins, self.directions)
        return RayBatch(
            np.ascontiguousarray(self.origins[begin:end], dtype),
            np.ascontiguousarray(self.directions[begin:end], dtype),
            self.t_min if len(self.t_min) == 1 else self.t_min[begin:end],
            self.t_max if len(self.t_max) == 1 else self.t_max[begin:end],
        )


@dataclass(frozen=True, eq=False)
class RayBox:
    """The box that rays are moved to: as large on both sides of the mesh's origin.

    Attributes
    ----------
    centre : (3,) float64, the file's coordinates
        The mesh's origin.
    half : (3,) float64
    """

    centre: NDArray[np.float64]
    half: NDArray[np.float64]

    @classmethod
    def around(cls, bvh: Bvh) -> RayBox:
        """Return the box around a tree."""
        root = bvh.nodes[0]
        reach = np.maximum(np.abs(root["aabb_min"]), np.abs(root["aabb_max"])).astype(np.float64)
        return cls(np.asarray(bvh.mesh.origin, np.float64), reach)


def read_rays(origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike) -> RayBatch:
    """Return rays as arrays of the right shapes, without a copy where possible.

    Raises
    ------
    ValueError
        A wrong shape, or a limit that is a wrong number.
    """
    start, along = read_rows(origins, "origins"), read_rows(directions, "directions")
    if len(start) != len(along):
        raise ValueError(f"origins and directions must have equally many rows, not {len(start)} and {len(along)}")
    return RayBatch(start, along, _read_limits(t_min, "t_min", len(start)), _read_limits(t_max, "t_max", len(start)))


def read_rows(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (n, 3) float32 or float64."""
    rows = np.asarray(values)
    if rows.dtype not in (np.float32, np.float64):
        rows = rows.astype(np.float64)
    if rows.size == 0 and rows.ndim < 2:
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), not {rows.shape}")
    return rows


def _read_limits(values: ArrayLike, name: str, ray_count: int) -> NDArray[np.float64]:
    """Return a number as (1,), or one for each ray; infinity is allowed."""
    limits = np.asarray(values, np.float64)
    if limits.shape not in ((), (ray_count,)):
        raise ValueError(f"{name} must be a number or have shape ({ray_count},), not {limits.shape}")
    least = 0.0 if name == "t_min" else -np.inf
    bad = ~(limits >= least)  # written so that NaN is bad
    if bad.any():
        row = int(np.argmax(bad))
        place = f"{name}[{row}]" if limits.shape else name
        wanted = "a number" if least == -np.inf else f"a number from {least:g}"
        raise ValueError(f"{place} must be {wanted}, not {limits.flat[row]}")
    return limits.reshape(-1)


def pack_rays(
    batch: RayBatch,
    box: RayBox,
    rays: NDArray[np.void],
    *,
    first_row: int = 0,
    order: NDArray[np.int32] = GIVEN_ORDER,
) -> None:
    """Write rays as the device wants them: some are advanced, some scaled, so their t is not the user's.

    Parameters
    ----------
    batch : RayBatch
        What `RayBatch.part` returns.
    box : RayBox
    rays : (n,) `layout.RAY`
        Written.
    first_row : int
        The number of the batch's first ray, for messages.
    order : (n,) int32
        Which of the batch's rays are written; all, one after the other, without it.

    Raises
    ------
    ValueError
        A value that is not finite, or a direction of length zero; the message names the first bad row.
    """
    lanes = rays.view(np.float32).reshape(-1, _RAY_LANES)
    given = batch.origins, batch.directions, batch.t_min, batch.t_max, box.centre, box.half
    bad = _pack(*given, order, lanes)
    if bad != _ALL_GOOD and len(order) > 0:
        # In another order, it need not be the first bad one.
        bad = _pack(*given, GIVEN_ORDER, np.empty((len(batch), _RAY_LANES), np.float32))
    if bad != _ALL_GOOD:
        _refuse(batch, bad, first_row + bad)


def _refuse(batch: RayBatch, row: int, number: int) -> None:
    """Say what is wrong with a ray."""
    for name, values in (("origins", batch.origins), ("directions", batch.directions)):
        if not np.isfinite(values[row]).all():
            raise ValueError(f"{name}[{number}] is not finite: {values[row]}")
    raise ValueError(f"directions[{number}] has length zero")


@njit(cache=True, nogil=True)
def scale_exponent(longest):  # type: ignore[no-untyped-def]
    """Return by which power of two a direction with this longest component is divided: 0 for most."""
    if longest < _SHORT or longest > _LONG:
        return math.frexp(longest)[1]
    return 0


@njit(cache=True, nogil=True)
def _pack(origins, directions, t_mins, t_maxs, centre, half, order, rays):  # type: ignore[no-untyped-def]
    """Write the rays; return the number of the first bad one that is come across, or _ALL_GOOD."""
    size = max(half[0], half[1], half[2])
    near = _NEAR_SHARE * size
    centre_x, centre_y, centre_z = centre[0], centre[1], centre[2]
    each_t_min, each_t_max = len(t_mins) > 1, len(t_maxs) > 1
    is_ordered = len(order) > 0
    if len(origins) > 0:
        t_min, t_max = t_mins[0], t_maxs[0]
    for place in range(len(rays)):
        ray = place
        if is_ordered:
            ray = np.int64(order[place])
            coming = 3 * np.int64(order[min(place + _AHEAD, len(rays) - 1)])  # both ends: rows cross cache lines
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
        # Written so that NaN and infinity take the long way.
        if (
            longest >= _SHORT and size_x <= _LONG and size_y <= _LONG and size_z <= _LONG
            and abs(x) <= near and abs(y) <= near and abs(z) <= near
        ):  # fmt: skip
            _write(rays, place, x, y, z, t_min, dx, dy, dz, t_max)
            continue
        # Infinity minus infinity is NaN, and so is anything with NaN.
        finite = (dx - dx) + (dy - dy) + (dz - dz) == 0.0
        for axis in range(3):
            finite &= origins[ray, axis] - origins[ray, axis] == 0.0
        if not (finite and longest > 0.0):
            return ray
        _write_moved(rays, place, x, y, z, t_min, dx, dy, dz, t_max, longest, half, size)
    return _ALL_GOOD


@njit(cache=True, nogil=True)
def _write(rays, ray, x, y, z, t_min, dx, dy, dz, t_max):  # type: ignore[no-untyped-def]
    rays[ray, 0], rays[ray, 1], rays[ray, 2] = x, y, z
    rays[ray, _T_MIN_LANE] = t_min
    rays[ray, _DIRECTION_LANE], rays[ray, _DIRECTION_LANE + 1], rays[ray, _DIRECTION_LANE + 2] = dx, dy, dz
    rays[ray, _T_MAX_LANE] = t_max


@njit(cache=True, nogil=True, error_model="numpy")
def _write_moved(rays, ray, x, y, z, t_min, dx, dy, dz, t_max, longest, half, size):  # type: ignore[no-untyped-def]
    """Write a ray with a direction of moderate length, and its origin close to the box."""
    exponent = scale_exponent(longest)
    if exponent != 0:
        dx, dy, dz = math.ldexp(dx, -exponent), math.ldexp(dy, -exponent), math.ldexp(dz, -exponent)
        longest = math.ldexp(longest, -exponent)
        t_min, t_max = math.ldexp(t_min, exponent), math.ldexp(t_max, exponent)
    near = _NEAR_SHARE * size
    if abs(x) <= near and abs(y) <= near and abs(z) <= near:
        _write(rays, ray, x, y, z, t_min, dx, dy, dz, t_max)
        return

    # Where does it enter the box, and where does it leave? Written so that NaN is a miss.
    slack = _BOX_SLACK * size + _DISTANCE_SLACK * (abs(x) + abs(y) + abs(z))
    enter, leave = _clip(x, dx, half[0] + slack, 0.0, t_max)
    enter, leave = _clip(y, dy, half[1] + slack, enter, leave)
    enter, leave = _clip(z, dz, half[2] + slack, enter, leave)
    if not (enter <= leave and leave >= t_min):
        _write(rays, ray, 0.0, 0.0, 0.0, 0.0, dx, dy, dz, -1.0)
        return
    step = math.ldexp(1.0, math.frexp(size)[1] - math.frexp(longest)[1] - _STEP_EXPONENT)
    advance = np.floor(enter / step) * step
    x, y, z = x + advance * dx, y + advance * dy, z + advance * dz
    _write(rays, ray, x, y, z, max(t_min - advance, 0.0), dx, dy, dz, t_max - advance)


@njit(cache=True, nogil=True, error_model="numpy")
def _clip(origin, direction, half, enter, leave):  # type: ignore[no-untyped-def]
    """Narrow an interval of a ray to what is between -half and half on one axis."""
    if direction == 0.0:
        return (enter, leave) if abs(origin) <= half else (np.inf, -np.inf)
    inverse = 1.0 / direction
    middle, width = -origin * inverse, half * abs(inverse)
    return max(enter, middle - width), min(leave, middle + width)

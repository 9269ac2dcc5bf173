"""From what the device found to what is returned: each hit computed again in float64, on the triangle found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import NO_PRIM
from ..simd import prefetch
from .crossings import PLACE_BITS, PLACE_MASK, Crossings
from .rays import RayBatch, scale_exponent

# A hit from the device as 4-byte lanes.
HIT_LANES = 4
_U_LANE, _V_LANE, _PRIM_LANE = 1, 2, 3

# Hits are refined so many at a time: first all is fetched, then comes the arithmetic, which the compiler turns into
# vector instructions, then the exceptions. Hit by hit it takes twice as long, and so few stay in the first-level cache.
_BLOCK = 128

# Triangles, and what the device found, are asked for so many hits ahead: 8 to 16 are alike.
_AHEAD = 12

# Rays that are made contiguous at a time, where they are not.
_MOST_RAYS = 2**20

# What is known of the hits of a block: vectors, a row for each axis.
_ORIGIN, _DIRECTION, _CORNER, _AB, _AC, _TUV = range(6)


def refine_hits(
    batch: RayBatch,
    mesh: Mesh,
    found: NDArray[np.void],
    t: NDArray[np.floating],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    prim_id: NDArray[np.int32],
) -> None:
    """Write one hit for each ray in float64.

    Parameters
    ----------
    batch : RayBatch
        The rays that were cast, as the user gave them.
    mesh : Mesh
    found : (n,) `layout.HIT`
        What the device found.
    t, u, v, prim_id : (n,) arrays
        Written. Where float64 puts the hit beside the triangle by less than float32 resolves, u and v are the device's,
        and t is where the ray is nearest to that point.
    """
    lanes = _lanes(found)
    _refine_each(
        batch.origins, batch.directions, batch.t_min, batch.t_max, mesh.origin, mesh.vertices, mesh.faces,
        lanes, lanes.view(np.int32), t, u, v, prim_id,
    )  # fmt: skip


def refine_runs(
    batch: RayBatch,
    mesh: Mesh,
    crossings: Crossings,
    begin: int,
    end: int,
    places: NDArray[np.int64],
    t: NDArray[np.floating],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    prim_id: NDArray[np.integer],
    ray_id: NDArray[np.int64],
    locations: NDArray[np.float64],
) -> None:
    """Write several hits for each ray in float64.

    Parameters
    ----------
    batch : RayBatch
        All rays.
    mesh : Mesh
    crossings : Crossings
    begin, end : int
        Which rays are worked on.
    places : (1,) or (depths,) int64
        Where the first hit goes, and the others behind it, ray after ray; or, if there is a `ray_id`, where the first
        one of each depth goes. Changed.
    t, u, v, prim_id, ray_id, locations : arrays
        Written; those without rows are not wanted; `locations` is (m, 3). No t is smaller than that of the crossing
        before it on the ray: the device's order holds for all queries, so that `all_hits` begins with what
        `closest_hit` finds; where two crossings are closer than float32 resolves, float64 may see them the other way
        round.
    """
    lanes = _lanes(crossings.found)
    for first in range(begin, end, _MOST_RAYS):
        last = min(first + _MOST_RAYS, end)
        part = batch.part(first, last)
        _refine_runs(
            part.origins, part.directions, part.t_min, part.t_max, mesh.origin, mesh.vertices, mesh.faces,
            lanes, lanes.view(np.int32), crossings.counts[first:last], crossings.sources[first:last],
            crossings.piece_begins, first, places, t, u, v, prim_id, ray_id, locations,
        )  # fmt: skip


def _lanes(found: NDArray[np.void]) -> NDArray[Any]:
    return np.ascontiguousarray(found).view(np.float32).reshape(-1, HIT_LANES)


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_each(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, centre, vertices, faces, found, found_ints, t, u, v, prim_id
):
    block, exponents = np.empty((_TUV + 1, 3, _BLOCK)), np.empty(_BLOCK, np.int64)
    rays, no_locations = np.empty(_BLOCK, np.int64), np.empty((0, 3))
    count = 0
    for ray in range(len(found)):
        prim = found_ints[ray, _PRIM_LANE]
        prim_id[ray] = prim
        if prim == NO_PRIM:
            t[ray], u[ray], v[ray] = np.inf, 0.0, 0.0
        else:
            rays[count] = ray
            count += 1
        if count == _BLOCK or ray == len(found) - 1:
            listed = rays[:count]
            _fetch(origins, directions, centre, vertices, faces, found_ints, listed, listed, block, exponents)
            _meet_planes(block, count)
            _settle(t_mins, t_maxs, centre, found, listed, listed, listed, block, exponents, t, u, v, no_locations)
            count = 0


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_runs(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, centre, vertices, faces, found, found_ints, counts, codes, piece_begins,
    first_ray, places, t, u, v, prim_id, ray_id, locations,
):  # fmt: skip
    block, exponents = np.empty((_TUV + 1, 3, _BLOCK)), np.empty(_BLOCK, np.int64)
    rays, sources, targets = np.empty(_BLOCK, np.int64), np.empty(_BLOCK, np.int64), np.empty(_BLOCK, np.int64)
    by_depth, with_points = len(ray_id) > 0, len(t) > 0 or len(locations) > 0
    first_place = places[0] if len(places) > 0 else 0
    ray, depth = 0, 0
    while ray < len(counts):
        count = 0
        while ray < len(counts) and count < _BLOCK:
            if depth == counts[ray]:
                ray, depth = ray + 1, 0
                if ray + _AHEAD < len(counts):
                    prefetch(found, HIT_LANES * _find_source(codes[ray + _AHEAD], piece_begins) + _PRIM_LANE)
                continue
            slot = depth if by_depth else 0
            rays[count], targets[count] = ray, places[slot]
            sources[count] = _find_source(codes[ray], piece_begins) + depth
            places[slot] += 1
            depth += 1
            count += 1
        for hit in range(count):
            prim_id[targets[hit]] = found_ints[sources[hit], _PRIM_LANE]
            if by_depth:
                ray_id[targets[hit]] = first_ray + rays[hit]
        if with_points:
            listed, wanted = rays[:count], sources[:count]
            _fetch(origins, directions, centre, vertices, faces, found_ints, listed, wanted, block, exponents)
            _meet_planes(block, count)
            _settle(t_mins, t_maxs, centre, found, listed, wanted, targets, block, exponents, t, u, v, locations)
    if len(t) > 0:
        place = first_place
        for ray in range(len(counts)):
            for depth in range(counts[ray]):
                if depth > 0:
                    t[place] = max(t[place], t[place - 1])
                place += 1


@njit(cache=True, nogil=True)
def _find_source(code, piece_begins):  # type: ignore[no-untyped-def]
    """Return where the first hit of a ray is, see `Crossings`."""
    return piece_begins[code >> PLACE_BITS] + (code & PLACE_MASK)


@njit(cache=True, nogil=True)
def _fetch(  # type: ignore[no-untyped-def]
    origins, directions, centre, vertices, faces, found_ints, rays, sources, block, exponents
):
    """Write the rays and the triangles of some hits into a block, directions of moderate length."""
    last = len(rays) - 1
    for hit in range(len(rays)):
        prefetch(faces, 3 * found_ints[sources[hit], _PRIM_LANE])
    for hit in range(len(rays)):
        ray, prim = rays[hit], found_ints[sources[hit], _PRIM_LANE]
        coming = found_ints[sources[min(hit + _AHEAD, last)], _PRIM_LANE]
        for corner in range(3):
            prefetch(vertices, 3 * faces[coming, corner])
        dx, dy, dz = np.float64(directions[ray, 0]), np.float64(directions[ray, 1]), np.float64(directions[ray, 2])
        exponent = scale_exponent(max(abs(dx), abs(dy), abs(dz)))
        if exponent != 0:
            dx, dy, dz = math.ldexp(dx, -exponent), math.ldexp(dy, -exponent), math.ldexp(dz, -exponent)
        exponents[hit] = exponent
        block[_DIRECTION, 0, hit], block[_DIRECTION, 1, hit], block[_DIRECTION, 2, hit] = dx, dy, dz
        ia, ib, ic = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        for axis in range(3):
            a = np.float64(vertices[ia, axis])
            block[_ORIGIN, axis, hit] = origins[ray, axis] - centre[axis]
            block[_CORNER, axis, hit] = a
            block[_AB, axis, hit] = vertices[ib, axis] - a
            block[_AC, axis, hit] = vertices[ic, axis] - a


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_planes(block, count):  # type: ignore[no-untyped-def]
    """Write where each ray of a block meets the plane of its triangle.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    for hit in range(count):
        dx, dy, dz = block[_DIRECTION, 0, hit], block[_DIRECTION, 1, hit], block[_DIRECTION, 2, hit]
        abx, aby, abz = block[_AB, 0, hit], block[_AB, 1, hit], block[_AB, 2, hit]
        acx, acy, acz = block[_AC, 0, hit], block[_AC, 1, hit], block[_AC, 2, hit]
        tx = block[_CORNER, 0, hit] - block[_ORIGIN, 0, hit]
        ty = block[_CORNER, 1, hit] - block[_ORIGIN, 1, hit]
        tz = block[_CORNER, 2, hit] - block[_ORIGIN, 2, hit]
        px, py, pz = dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx
        qx, qy, qz = ty * abz - tz * aby, tz * abx - tx * abz, tx * aby - ty * abx
        volume = abx * px + aby * py + abz * pz
        block[_TUV, 0, hit] = -(acx * qx + acy * qy + acz * qz) / volume
        block[_TUV, 1, hit] = -(tx * px + ty * py + tz * pz) / volume
        block[_TUV, 2, hit] = -(dx * qx + dy * qy + dz * qz) / volume


@njit(cache=True, nogil=True, error_model="numpy")
def _settle(  # type: ignore[no-untyped-def]
    t_mins, t_maxs, centre, found, rays, sources, places, block, exponents, t, u, v, locations
):
    """Put the hits of a block where they belong: on the triangle, within the limits, and into the results."""
    for hit in range(len(rays)):
        ray, place = rays[hit], places[hit]
        hit_t, hit_u, hit_v = block[_TUV, 0, hit], block[_TUV, 1, hit], block[_TUV, 2, hit]
        is_beside = not (hit_u >= 0.0 and hit_v >= 0.0 and hit_u + hit_v <= 1.0 and np.isfinite(hit_t))
        if is_beside:
            # The device sees a rounded ray, which can cross the triangle where this one passes beside it.
            hit_u, hit_v = np.float64(found[sources[hit], _U_LANE]), np.float64(found[sources[hit], _V_LANE])
            along, square = 0.0, 0.0
            for axis in range(3):
                offset = hit_u * block[_AB, axis, hit] + hit_v * block[_AC, axis, hit]
                direction = block[_DIRECTION, axis, hit]
                along += ((block[_CORNER, axis, hit] - block[_ORIGIN, axis, hit]) + offset) * direction
                square += direction * direction
            hit_t = along / square
        if exponents[hit] != 0:
            hit_t = math.ldexp(hit_t, -exponents[hit])
        if len(t) > 0:
            t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
            t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
            t[place], u[place], v[place] = min(max(hit_t, t_min), t_max), hit_u, hit_v
        if len(locations) > 0:
            for axis in range(3):
                offset = hit_u * block[_AB, axis, hit] + hit_v * block[_AC, axis, hit]
                locations[place, axis] = centre[axis] + (block[_CORNER, axis, hit] + offset)

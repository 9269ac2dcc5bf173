"""From what the device found to what is returned: each hit computed again in float64, on the triangle found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import NO_PRIM
from .rays import RayBatch, scale_exponent

# A hit from the device as 4-byte lanes.
HIT_LANES = 4
_PRIM_LANE = 3


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
    found: NDArray[np.void],
    counts: NDArray[np.int64],
    begins: NDArray[np.int64],
    t: NDArray[np.floating],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    prim_id: NDArray[np.int32],
    locations: NDArray[np.float64],
) -> None:
    """Write several hits for each ray in float64, in the device's order.

    Parameters
    ----------
    batch, mesh
        As in `refine_hits`.
    found : (m,) `layout.HIT`
        The hits of the first ray, then those of the second one, and so on.
    counts : (n,) int64
        How many each ray has.
    begins : (n,) int64
        Where those of each ray are written.
    t, u, v, prim_id, locations : arrays
        Written; `locations` is (hits, 3), or without rows when nobody wants them. No t is smaller than that of the
        crossing before it on the ray: the device's order holds for all queries, so that `all_hits` begins with what
        `closest_hit` finds; where two crossings are closer than float32 resolves, float64 may see them the other way
        round.
    """
    lanes = _lanes(found)
    _refine_runs(
        batch.origins, batch.directions, batch.t_min, batch.t_max, mesh.origin, mesh.vertices, mesh.faces,
        lanes, lanes.view(np.int32), counts, begins, t, u, v, prim_id, locations,
    )  # fmt: skip


def _lanes(found: NDArray[np.void]) -> NDArray[Any]:
    return np.ascontiguousarray(found).view(np.float32).reshape(-1, HIT_LANES)


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_each(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, centre, vertices, faces, found, found_ints, t, u, v, prim_id
):
    for ray in range(len(found)):
        prim = found_ints[ray, _PRIM_LANE]
        prim_id[ray] = prim
        if prim == NO_PRIM:
            t[ray], u[ray], v[ray] = np.inf, 0.0, 0.0
        else:
            t[ray], u[ray], v[ray], _, _, _ = _refine(
                origins, directions, t_mins, t_maxs, ray, centre, vertices, faces, prim, found, ray
            )


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_runs(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, centre, vertices, faces, found, found_ints, counts, begins,
    t, u, v, prim_id, locations,
):  # fmt: skip
    source = 0
    for ray in range(len(counts)):
        least = -np.inf
        for place in range(begins[ray], begins[ray] + counts[ray]):
            prim = found_ints[source, _PRIM_LANE]
            prim_id[place] = prim
            hit_t, u[place], v[place], x, y, z = _refine(
                origins, directions, t_mins, t_maxs, ray, centre, vertices, faces, prim, found, source
            )
            least = max(least, hit_t)
            t[place] = least
            if len(locations) > 0:
                locations[place, 0], locations[place, 1], locations[place, 2] = x, y, z
            source += 1


@njit(inline="always")
def _refine(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, ray, centre, vertices, faces, prim, found, hit
):
    """Return t, u, v and the location of a hit.

    Inlined by hand, because handing over nine arrays takes longer than the rest.
    """
    ox, oy, oz = origins[ray, 0] - centre[0], origins[ray, 1] - centre[1], origins[ray, 2] - centre[2]
    dx, dy, dz = np.float64(directions[ray, 0]), np.float64(directions[ray, 1]), np.float64(directions[ray, 2])
    exponent = scale_exponent(max(abs(dx), abs(dy), abs(dz)))
    if exponent != 0:
        dx, dy, dz = math.ldexp(dx, -exponent), math.ldexp(dy, -exponent), math.ldexp(dz, -exponent)

    # Where the ray meets the plane (Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997).
    ia, ib, ic = faces[prim, 0], faces[prim, 1], faces[prim, 2]
    ax, ay, az = np.float64(vertices[ia, 0]), np.float64(vertices[ia, 1]), np.float64(vertices[ia, 2])
    abx, aby, abz = vertices[ib, 0] - ax, vertices[ib, 1] - ay, vertices[ib, 2] - az
    acx, acy, acz = vertices[ic, 0] - ax, vertices[ic, 1] - ay, vertices[ic, 2] - az
    tx, ty, tz = ax - ox, ay - oy, az - oz
    px, py, pz = dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx
    qx, qy, qz = ty * abz - tz * aby, tz * abx - tx * abz, tx * aby - ty * abx
    volume = abx * px + aby * py + abz * pz
    u = -(tx * px + ty * py + tz * pz) / volume
    v = -(dx * qx + dy * qy + dz * qz) / volume
    t = -(acx * qx + acy * qy + acz * qz) / volume
    is_beside = not (u >= 0.0 and v >= 0.0 and u + v <= 1.0 and np.isfinite(t))
    if is_beside:
        # The device sees a rounded ray, which can cross the triangle where this one passes beside it.
        u, v = np.float64(found[hit, 1]), np.float64(found[hit, 2])
    x, y, z = u * abx + v * acx, u * aby + v * acy, u * abz + v * acz
    if is_beside:
        t = ((tx + x) * dx + (ty + y) * dy + (tz + z) * dz) / (dx * dx + dy * dy + dz * dz)
    if exponent != 0:
        t = math.ldexp(t, -exponent)
    t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
    t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
    return min(max(t, t_min), t_max), u, v, centre[0] + (ax + x), centre[1] + (ay + y), centre[2] + (az + z)

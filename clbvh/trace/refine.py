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
    ray_ids: NDArray[np.int64] | None = None,
) -> None:
    """Write hits in float64.

    Parameters
    ----------
    batch : RayBatch
        The rays that were cast, as the user gave them.
    mesh : Mesh
    found : (m,) `layout.HIT`
        What the device found.
    t, u, v, prim_id : (m,) arrays
        Written. Where float64 puts the hit beside the triangle by less than float32 resolves, u and v are the device's,
        and t is where the ray is nearest to that point.
    ray_ids : (m,) int64, optional
        The ray of each hit; without it, hit i belongs to ray i.
    """
    lanes: NDArray[Any] = np.ascontiguousarray(found).view(np.float32).reshape(-1, HIT_LANES)
    rays = np.empty(0, np.int64) if ray_ids is None else ray_ids
    _refine(
        batch.origins, batch.directions, batch.t_min, batch.t_max, rays, ray_ids is None,
        mesh.origin, mesh.vertices, mesh.faces, lanes, lanes.view(np.int32), t, u, v, prim_id,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _refine(  # type: ignore[no-untyped-def]
    origins, directions, t_mins, t_maxs, ray_ids, one_each, centre, vertices, faces, found, found_ints,
    t, u, v, prim_id,
):  # fmt: skip
    for hit in range(len(found)):
        prim = found_ints[hit, _PRIM_LANE]
        prim_id[hit] = prim
        if prim == NO_PRIM:
            t[hit], u[hit], v[hit] = np.inf, 0.0, 0.0
            continue
        ray = hit if one_each else ray_ids[hit]
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
        ax, ay, az = ax - ox, ay - oy, az - oz
        px, py, pz = dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx
        qx, qy, qz = ay * abz - az * aby, az * abx - ax * abz, ax * aby - ay * abx
        volume = abx * px + aby * py + abz * pz
        hit_u = -(ax * px + ay * py + az * pz) / volume
        hit_v = -(dx * qx + dy * qy + dz * qz) / volume
        hit_t = -(acx * qx + acy * qy + acz * qz) / volume
        if not (hit_u >= 0.0 and hit_v >= 0.0 and hit_u + hit_v <= 1.0 and np.isfinite(hit_t)):
            # The device sees a rounded ray, which can cross the triangle where this one passes beside it.
            hit_u, hit_v = np.float64(found[hit, 1]), np.float64(found[hit, 2])
            ax, ay, az = ax + hit_u * abx + hit_v * acx, ay + hit_u * aby + hit_v * acy, az + hit_u * abz + hit_v * acz
            hit_t = (ax * dx + ay * dy + az * dz) / (dx * dx + dy * dy + dz * dz)
        if exponent != 0:
            hit_t = math.ldexp(hit_t, -exponent)
        t_min = t_mins[0] if len(t_mins) == 1 else t_mins[ray]
        t_max = t_maxs[0] if len(t_maxs) == 1 else t_maxs[ray]
        t[hit], u[hit], v[hit] = min(max(hit_t, t_min), t_max), hit_u, hit_v

"""Hits from the device are computed again in float64, on the file's own vertices.

Of what the device found only the primitive counts. So t, u and v depend on nothing but the ray and the primitive, and
not on the layout, the device, or its compiler. Hits are refined in blocks, see `refine_block.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import HIT_PRIM_ID, NO_PRIM, WORLD_HIT_INSTANCE_ID
from ...support.compiled import compiled
from ..rays.batch import RayRows
from ..world.surface_arrays import SurfaceArrays
from .hits import Hits
from .refine_block import BLOCK_HITS, TUV, RefineBlock, refine_block
from .surface import Surface

# The t of a hit beyond float64: infinity is the t of a miss.
_MOST_T = np.finfo(np.float64).max


class RefinedHits(NamedTuple):
    """Where refined hits go, one element for each hit; see `Hits`.

    `instance_id` has no elements for hits on a lone mesh.
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    is_front: NDArray[np.bool_]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, count: int, *, has_instances: bool = False) -> RefinedHits:
        """Return arrays for hits, not yet written."""
        t, u, v, is_front = np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.bool_)
        return cls(t, u, v, is_front, np.empty(count, np.int32), np.empty(count if has_instances else 0, np.int32))

    def part(self, begin: int, end: int) -> RefinedHits:
        """Return views for some of the hits."""
        part = slice(begin, end)
        return RefinedHits(*(values[part] for values in self))  # type: ignore[arg-type]

    def as_hits(self, shape: tuple[int, ...], surface: Surface) -> Hits:
        """Return the hits of rays of a leading shape."""
        t, u, v = (values.reshape(shape) for values in (self.t, self.u, self.v))
        return Hits(
            t, u, v, self.prim_id.reshape(shape), surface.lone_mesh,
            is_front=self.is_front.reshape(shape), surface=surface,
            known_instance_id=None if surface.arrays.is_lone else self.instance_id.reshape(shape),
        )  # fmt: skip


def refine_closest(rays: RayRows, surface: SurfaceArrays, found: NDArray[np.void], hits: RefinedHits) -> None:
    """Write one hit for each ray in float64.

    Parameters
    ----------
    rays : RayRows
        The rays that were cast, as the user gave them.
    surface : SurfaceArrays
    found : (n,) `structs.HIT` or `structs.WORLD_HIT`
        What the device found.
    hits : RefinedHits of (n,) arrays, written
        Where float64 sees the ray pass beside the primitive, by less than float32 resolves, t, u and v are those of the
        primitive's point that is nearest to the ray.
    """
    lanes = np.ascontiguousarray(found).view(np.float32).reshape(-1, found.dtype.itemsize // 4)
    refine_found(rays, surface, lanes.view(np.int32), RefineBlock.make(), hits)


@compiled(error_model="numpy")
def refine_found(rays, surface, found_ints, block, hits):
    """Write one hit for each ray, as `refine_closest`; `found_ints` are (n, lanes) int32."""
    t, u, v, is_front = hits.t, hits.u, hits.v, hits.is_front
    prim_id, instance_id = hits.prim_id, hits.instance_id
    count = 0
    for ray in range(len(found_ints)):
        prim = found_ints[ray, HIT_PRIM_ID]
        prim_id[ray] = prim
        if len(instance_id) > 0:
            instance_id[ray] = found_ints[ray, WORLD_HIT_INSTANCE_ID] if prim != NO_PRIM else NO_PRIM
        if prim == NO_PRIM:
            t[ray], u[ray], v[ray], is_front[ray] = np.inf, 0.0, 0.0, False
        else:
            block.rays[count] = block.sources[count] = block.targets[count] = ray
            count += 1
        if count == BLOCK_HITS or ray == len(found_ints) - 1:
            refine_block(rays, surface, found_ints, block, count)
            store_hits(rays.t_min, rays.t_max, block, count, hits)
            count = 0


@compiled
def store_hits(t_mins, t_maxs, block, count, hits):
    """Write t, within the ray's limits, u, v and side of a block's hits to their targets."""
    tuv, volumes = block.vectors[TUV], block.volumes
    t, u, v, is_front, targets = hits.t, hits.u, hits.v, hits.is_front, block.targets
    for hit in range(count):
        ray, target = block.rays[hit], targets[hit]
        t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
        t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
        t[target] = min(max(tuv[0, hit], t_min), t_max, _MOST_T)
        u[target], v[target], is_front[target] = tuv[1, hit], tuv[2, hit], volumes[hit] > 0.0

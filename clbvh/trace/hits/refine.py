"""Hits from the device, computed again in float64 on the file's own vertices: cl/hits/refine.cl tells how."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ..rays.batch import RayBatch
from ..world.surface_arrays import SurfaceArrays
from .hits import Hits
from .surface import Surface

# Least hits of a thread's range. Refining one takes 40 to 100 ns, and waking a thread as long as 600 to 1,500 of them.
LEAST_HITS = 1 << 11

_LOOPS = Loops("hits/refine")


class RefinedHits(NamedTuple):
    """Where refined hits go, one element for each hit; see `Hits`.

    `instance_id` has no elements for hits on a lone shape.
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    is_front: NDArray[np.bool_]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, shape: int | tuple[int, ...], *, is_lone: bool = True) -> RefinedHits:
        """Return arrays for hits, not yet written."""
        t, u, v, is_front = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)
        return cls(t, u, v, is_front, np.empty(shape, np.int32), np.empty(0 if is_lone else shape, np.int32))

    def part(self, begin: int, end: int) -> RefinedHits:
        """Return views for some of the hits, (n,) but for those of all."""
        if end - begin == self.t.size:  # views would cost a call with one ray 3 % of its time
            return self
        part = slice(begin, end)
        return RefinedHits(*(values.reshape(-1)[part] for values in self))  # type: ignore[arg-type]

    def reshape(self, *shape: int) -> RefinedHits:
        """Return views of another shape."""
        arrays = [values.reshape(shape) if values.size == self.t.size else values for values in self]
        return RefinedHits(*arrays)  # type: ignore[arg-type]

    def as_hits(self, surface: Surface) -> Hits:
        """Return the hits."""
        t, u, v, is_front, prim_id, instance_id = self
        of_instances = None if surface.arrays.is_lone else instance_id
        return Hits(t, u, v, prim_id, is_front=is_front, surface=surface, known_instance_id=of_instances)


def refine_closest(
    batch: RayBatch, first_ray: int, arrays: SurfaceArrays, found: NDArray[np.void], hits: RefinedHits
) -> None:
    """Write one hit in float64 for each of some rays.

    Parameters
    ----------
    batch : RayBatch
    first_ray : int
    arrays : SurfaceArrays
    found : (n,) `structs.HIT` of a lone shape, else `structs.WORLD_HIT`
        What the device found.
    hits : RefinedHits of (n,) arrays, written
        Where float64 sees the ray pass beside the primitive, by less than float32 resolves, t, u and v are those of the
        primitive's point that is nearest to the ray.
    """
    found = np.ascontiguousarray(found)
    of_kind = (found, None) if arrays.is_lone else (None, found)
    _LOOPS.refine_closest(arrays.addresses, batch.addresses, first_ray, *of_kind, len(found), *hits)

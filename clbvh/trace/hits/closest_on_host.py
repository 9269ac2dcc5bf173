"""The closest hits of few rays in float64: packed, traversed and refined in one compiled call.

Each call of a compiled function from Python costs microseconds, as long as tens of rays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...structs import PACKED_RAY_LANES
from ...support.compiled import compiled
from ..host.walk import FIELD_COUNT, walk
from ..rays.batch import RayBatch, TreeBox
from ..rays.pack import ALL_GOOD, NO_LOWS, explain_bad_ray, write_packed
from ..wide_arrays import WideArrays
from .refine import HitIds, RefinedHits, refine_found
from .refine_block import RefineBlock


def find_closest_on_host(
    tree: WideArrays, box: TreeBox, batch: RayBatch, surface: Any, hits: RefinedHits, ids: HitIds
) -> None:
    """Write the closest hit of each ray of a batch, to the last bit as `refine_closest` does of the device's.

    Parameters
    ----------
    tree : WideArrays
        Of a mesh.
    box : TreeBox
        Around it.
    batch : RayBatch
        At least one ray.
    surface : Triangles or SceneArrays
        See `refine_closest`.
    hits : RefinedHits of (n,) arrays, written
    ids : HitIds of (n,) arrays, written

    Raises
    ------
    QueryError
        A bad ray; see `pack_rays`.
    """
    count = batch.ray_count
    packed, found = np.empty((count, PACKED_RAY_LANES), np.float32), np.empty((count, FIELD_COUNT), np.int32)
    bad = _find_closest(
        batch.part(0, count), box, tree, surface, packed, found, NO_LOWS, RefineBlock.make(), hits, ids.prim_id,
        ids.instance_id,
    )  # fmt: skip
    if bad != ALL_GOOD:
        raise explain_bad_ray(batch, bad)


@compiled
def _find_closest(rays, box, tree, surface, packed, found, no_lows, block, hits, prim_id, instance_id):
    """Pack rays, traverse the tree with them and refine their hits; return as `write_packed`."""
    bad = write_packed(rays, box, None, packed, no_lows, no_lows)
    if bad == ALL_GOOD:
        walk(tree, packed, 0, found)
        refine_found(rays, surface, found, block, hits, prim_id, instance_id)
    return bad

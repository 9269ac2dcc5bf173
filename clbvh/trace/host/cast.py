"""Few rays, cast by the calling thread on the host.

To hand a launch to the driver and to be woken by it takes longer than to cast a few hundred rays. The tree is that of
the device, where host and device share their memory. Rays are packed as for the device, the traversal finds what the
device finds, see `walk.py`, and hits are refined as ever. A sample of many rays tells what they cost.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import HIT, PACKED_RAY_LANES
from ...support.compiled import compiled
from ..rays.batch import RayBatch, TreeBox
from ..rays.pack import ALL_GOOD, NO_LOWS, explain_bad_ray, write_packed
from ..wide_arrays import WideArrays
from .walk import ANSWER, FIELD_COUNT, LEAF_VISITS, NODE_STEPS, walk


def cast_on_host(tree: WideArrays, box: TreeBox, batch: RayBatch, most_crossings: int) -> NDArray[Any]:
    """Return what a kernel finds for each ray of a batch.

    Parameters
    ----------
    tree : WideArrays
        Of a mesh.
    box : TreeBox
        Around it.
    batch : RayBatch
    most_crossings : int
        0: the closest hit is wanted. Otherwise the number of crossings, up to this one.

    Returns
    -------
    (n,) `structs.HIT` or int32
        Of a hit, nothing but `prim_id` is valid.

    Raises
    ------
    QueryError
        A bad ray; see `pack_rays`.
    """
    found, bad = _find(tree, box, batch, most_crossings)
    if bad != ALL_GOOD:
        raise explain_bad_ray(batch, bad)
    return found[:, ANSWER] if most_crossings else found.view(HIT).reshape(-1)


def count_steps(tree: WideArrays, box: TreeBox, batch: RayBatch) -> float:
    """Return how many nodes and leaves a ray of a batch visits for its closest hit, on average; at least one ray.

    Of a batch with a bad ray, the answer is infinity.
    """
    found, bad = _find(tree, box, batch, 0)
    return float(found[:, NODE_STEPS].mean() + found[:, LEAF_VISITS].mean()) if bad == ALL_GOOD else math.inf


def _find(tree: WideArrays, box: TreeBox, batch: RayBatch, most_crossings: int) -> tuple[NDArray[np.int32], int]:
    """Return what `walk` finds for each ray, (n, FIELD_COUNT), and what `write_packed` returns."""
    count = batch.ray_count
    packed, found = np.empty((count, PACKED_RAY_LANES), np.float32), np.empty((count, FIELD_COUNT), np.int32)
    return found, _cast(batch.part(0, count), box, tree, most_crossings, packed, found, NO_LOWS)


@compiled
def _cast(rays, box, tree, most_crossings, packed, found, no_lows):
    """Pack rays and traverse the tree with them; return as `write_packed`."""
    bad = write_packed(rays, box, None, packed, no_lows, no_lows)
    if bad == ALL_GOOD:
        walk(tree, packed, most_crossings, found)
    return bad

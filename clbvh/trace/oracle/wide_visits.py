"""The cost of rays in the layouts `bvh4` and `bvh8`: node visits and triangle tests, counted on the host.

As in `cl/traversal/wide.cl` for the closest hit: nearest child first, and children beyond the nearest hit are skipped
when they are popped. From the root: there are no entry points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...bvh import Bvh
from ...layouts.device_arrays import make_device_arrays
from ...structs import PACKED_RAY, PACKED_RAY_LANES
from ..host.walk import FIELD_COUNT, walk
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays
from ..wide_arrays import WideArrays
from .visits import Visits


def count_wide_visits(bvh: Bvh, width: int, origins: ArrayLike, directions: ArrayLike) -> Visits:
    """Cast rays on the host through a wide tree, and count their steps.

    Parameters
    ----------
    bvh : Bvh
    width : int
        4 or 8.
    origins, directions
        See `Tracer.closest_hit`.

    Returns
    -------
    Visits
        A node step tests the boxes of all children of one node; a leaf visit is one block of up to `width` triangles.
    """
    batch, _ = read_rays(origins, directions, 0.0, np.inf)
    rays = np.empty(batch.ray_count, PACKED_RAY)
    pack_rays(batch, batch.part(0, batch.ray_count), TreeBox.around(bvh), rays)
    arrays = make_device_arrays(bvh, f"bvh{width}")
    found = np.empty((len(rays), FIELD_COUNT), np.int32)
    tree = WideArrays.of(arrays.nodes, arrays.blocks, width, arrays.stack_size)
    walk(tree, rays.view(np.float32).reshape(-1, PACKED_RAY_LANES), 0, found)
    return Visits(*np.ascontiguousarray(found.T))

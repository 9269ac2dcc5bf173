"""The hits of each geometry, for steps that take one geometry at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM


def group_by_geometry(geometry_id: NDArray[np.int32]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield each geometry that occurs, in ascending order, and the ascending indices of its hits; misses are left out.

    Parameters
    ----------
    geometry_id : (n,) int32
        The geometry of each hit; none is -1.
    """
    if len(geometry_id) == 0:
        return
    least, greatest = int(geometry_id.min()), int(geometry_id.max())
    if least == greatest:
        order, begins = np.arange(len(geometry_id)), np.zeros(1, np.int64)
    else:
        order = np.argsort(geometry_id, kind="stable")
        ordered = geometry_id[order]
        begins = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    for hits in np.split(order, begins[1:]):
        geometry = int(geometry_id[hits[0]])
        if geometry != NO_PRIM:
            yield geometry, hits

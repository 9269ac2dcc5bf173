"""Vertices with equal coordinates are one point, as in files that repeat them for each face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def find_points(vertices: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """Return (V,) int64, the point of each vertex, and the number of points; in O(V log V)."""
    # Turns -0.0 into 0.0, which is the same point.
    order = np.lexsort((vertices + 0.0).T)
    ordered = vertices[order]
    is_new = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]
    point_ids = np.empty(len(order), np.int64)
    point_ids[order] = np.cumsum(is_new) - 1
    return point_ids, int(is_new.sum())

"""Points that are listed once for each triangle become vertices that triangles share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def merge_points(points: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """Merge points whose coordinates have the same bits.

    Parameters
    ----------
    points : (n, 3) float32 or float64

    Returns
    -------
    vertices : (V, 3) of the same dtype
        Every point once, in the order of their first appearances.
    ids : (n,) int64
        The vertex of each point.

    Notes
    -----
    O(n log n) for any points, by sorting: a forged file could make a hash table quadratic.
    """
    bits = np.ascontiguousarray(points).view(f"u{points.itemsize}")
    order = np.lexsort(bits.T)
    ordered = bits[order]
    begins = np.ones(len(points), np.bool_)
    begins[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    # The sort is stable, so a run of equal points begins with the first of them.
    first = order[begins]
    number = np.empty(len(first), np.int64)
    number[np.argsort(first)] = np.arange(len(first))
    ids = np.empty(len(points), np.int64)
    ids[order] = number[np.cumsum(begins) - 1]
    return points[np.sort(first)], ids

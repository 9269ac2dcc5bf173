"""Triangle strips to triangles: each vertex forms one with the two before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face_limit import check_face_count

# In place of a vertex: the next one begins another strip.
RESTART = -1


def cut_strips(corners: NDArray[np.integer], sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Cut strips into triangles.

    Parameters
    ----------
    corners : (n,) int
        Vertex indices of all strips, concatenated; -1 ends a strip within a list as well.
    sizes : (s,) int
        Numbers per list.

    Returns
    -------
    (F, 3) int
        Triangles in the order of the strips, all wound like the first of their strip. Without those that have a vertex
        twice: they lead a strip round a corner, and are no surface.

    Raises
    ------
    MeshError
        The triangles do not fit the memory.
    """
    check_face_count(len(corners))
    numbers = np.insert(corners, np.cumsum(sizes)[:-1], RESTART)
    if len(numbers) < 3:
        return np.empty((0, 3), np.int64)
    positions = np.arange(len(numbers))
    begins = np.maximum.accumulate(np.where(numbers == RESTART, positions + 1, 0))
    triangles = np.lib.stride_tricks.sliding_window_view(numbers, 3).copy()
    # Every second triangle of a strip is wound the other way round.
    is_odd = (positions - begins)[:-2] % 2 == 1
    triangles[is_odd, 1:] = triangles[is_odd, :0:-1]
    first, second, third = triangles.T
    is_whole = (triangles != RESTART).all(axis=1)
    return triangles[is_whole & (first != second) & (second != third) & (third != first)]

"""The normals of faces, for corners that have no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .unit_vectors import normalize


def find_flat_normals(corners: NDArray[np.number]) -> NDArray[np.float32]:
    """Return the unit normals of triangles, (n, 3) float32; (0, 0, 1) for those without an area.

    Parameters
    ----------
    corners : (n, 3, 3) float
        The points at the corners of each triangle.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        points = np.asarray(corners, np.float64)
        u, v = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        # To a size of about 1: the product of tiny sides could underflow.
        u, v = (side / np.abs(side).max(axis=1, keepdims=True, initial=0) for side in (u, v))
        return normalize(np.nan_to_num(np.cross(u, v)))[0]

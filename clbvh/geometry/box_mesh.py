"""Boxes as a mesh, so that any builder builds a tree over them: over spheres, or over the instances of a scene.

A builder sees the boxes of triangles and nothing else. A triangle between two opposite corners of a box has that box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

# A box grows by this share of the largest half side of all boxes, which is at most 1 in local coordinates and at least
# 1/2 there: rounding a coordinate to float32 moves it by 2^-25 of that at most.
_GROWTH = 2.0**-23


def box_mesh(lower: NDArray[np.float64], upper: NDArray[np.float64], name: str) -> Mesh:
    """Return a mesh whose triangle i is a diagonal of box i.

    Parameters
    ----------
    lower, upper : (n, 3) float64
        Corners of the boxes, at least one, with ``lower <= upper``.
    name : str
        For messages.

    Returns
    -------
    Mesh
        Of n degenerate triangles. In local coordinates, the box of each contains what float64 has of its box.

    Raises
    ------
    MeshError
        A corner is not finite, or the boxes together are too small or too large, see `Mesh.from_arrays`.
    """
    least, greatest = lower.min(axis=0), upper.max(axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by the mesh
        growth = _GROWTH * float(np.max(greatest / 2 - least / 2))
        corners = np.stack((lower - growth, upper + growth), axis=1).reshape(-1, 3)
    first = 2 * np.arange(len(lower), dtype=np.int32)
    return Mesh.from_arrays(corners, np.stack((first, first + 1, first), axis=1), name=name)

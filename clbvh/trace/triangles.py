"""The arrays of a mesh in one value, for the compiled functions that compute in float64 on its triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh


class Triangles(NamedTuple):
    """What compiled functions need of a mesh.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's coordinates
    faces : (F, 3) int32
    scale : float
        A power of two: local units in one unit of the file. Lengths are scaled by it before they are multiplied with
        each other, so that no product leaves float64.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    scale: float


def triangles_of(mesh: Mesh) -> Triangles:
    """Return the arrays of a mesh."""
    return Triangles(mesh.vertices, mesh.faces, mesh.scale)

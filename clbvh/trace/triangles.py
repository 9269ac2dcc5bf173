"""The arrays of a mesh in one value, for the compiled functions that compute in float64 on its triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh


class Triangles(NamedTuple):
    """The arrays of a mesh, as compiled functions take them.

    Attributes
    ----------
    origin : (3,) float64
    vertices : (V, 3) float32
    faces : (F, 3) int32
    """

    origin: NDArray[np.float64]
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def triangles_of(mesh: Mesh) -> Triangles:
    """Return the arrays of a mesh."""
    return Triangles(mesh.origin, mesh.vertices, mesh.faces)

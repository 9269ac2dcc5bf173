"""The vertices of a mesh as its file has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clbvh import Mesh


def file_vertices(mesh: Mesh) -> NDArray[np.float64]:
    """Return the vertices in the file's coordinates, (V, 3)."""
    return mesh.vertices if mesh.vertices.dtype == np.float64 else mesh.vertices + mesh.origin

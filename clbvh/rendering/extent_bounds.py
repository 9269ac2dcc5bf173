"""The bounds of a view over all vertices of a mesh, or over all that a scene holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .scene_extent import SceneExtent
from .view_bounds import Turn, View, ViewBounds

# Vertices per step: 10 MB at a time.
_CHUNK_VERTICES = 2**17


def find_bounds(view: View | Turn, mesh: Mesh | SceneExtent) -> ViewBounds:
    """Return the bounds of all vertices, or of all that a scene holds."""
    if isinstance(mesh, SceneExtent):
        return view.bounds_of(mesh.largest(view.reaches()))
    bounds = ViewBounds()
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        points: NDArray[np.float64] = mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)
        view.include(bounds, points)
    return bounds

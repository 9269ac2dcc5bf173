"""The ground of a picture: a plane below all objects that shows their shadows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ..scene_extent import SceneExtent
from ..view_bounds import Reaches

# The radius up to which shadows are shown, in half diagonals of the box around all objects: a soft shadow of something
# as high as wide ends well within it.
_RADIUS = 4.0

# Vertices per step: they stay in the cache.
_CHUNK_VERTICES = 2**16


def find_ground(
    extent: Mesh | SceneExtent, up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the middle of the ground, (3,) float64 in the scene's coordinates, and its radius in the scene's unit.

    Parameters
    ----------
    extent : Mesh or SceneExtent
        What stands on the ground.
    up : (3,) float64, of length 1
    """
    half_diagonal = float(np.linalg.norm(np.ptp(extent.local_box.astype(np.float64), axis=0))) / 2
    below = extent.largest(Reaches(-up[None], np.zeros(1), np.zeros(3))) if isinstance(extent, SceneExtent) else None
    lowest = _find_lowest(extent, up) if isinstance(extent, Mesh) else -float(below[0])
    middle = extent.local_box.astype(np.float64).mean(axis=0)
    point = middle + (lowest - middle @ up) * up
    return extent.origin + point / extent.scale, _RADIUS * half_diagonal / extent.scale


def _find_lowest(mesh: Mesh, up: NDArray[np.float64]) -> float:
    """Return the least height of a vertex, in local units."""
    points, direction = mesh.local_vertices, up.astype(np.float32)
    return min(
        float((points[begin : begin + _CHUNK_VERTICES] @ direction).min())
        for begin in range(0, len(points), _CHUNK_VERTICES)
    )

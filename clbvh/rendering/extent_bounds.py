"""The bounds of views over all vertices of a mesh, or over all that a scene holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .scene_extent import SceneExtent
from .view_bounds import Reaches, Turn, View, ViewBounds

# Vertices per step: they stay in the cache, and OpenBLAS starts no threads for so few. With four times as many, its
# threads took 0.4 s of two busy cores for the dragon's vertices and four views; now it is 5 ms.
_CHUNK_VERTICES = 2**12


def find_bounds(view: View | Turn, mesh: Mesh | SceneExtent) -> ViewBounds:
    """Return the bounds of all vertices, or of all that a scene holds."""
    return find_bounds_of_all([view], mesh)[0]


def find_bounds_of_all(views: Sequence[View | Turn], mesh: Mesh | SceneExtent) -> list[ViewBounds]:
    """Return the bounds of several views that differ in nothing but the slopes of their sides; read once."""
    reaches = [view.reaches() for view in views]
    joined = Reaches(
        np.concatenate([each.slopes for each in reaches]),
        np.concatenate([each.around for each in reaches]),
        reaches[0].axis,
    )
    largest = _find_largest(joined, mesh)
    return [view.bounds_of(part) for view, part in zip(views, np.split(largest, len(views)), strict=True)]


def _find_largest(reaches: Reaches, mesh: Mesh | SceneExtent) -> NDArray[np.float64]:
    """Return (k,) float64: the largest value of each function."""
    if isinstance(mesh, SceneExtent):
        return mesh.largest(reaches)
    largest = np.full(len(reaches.slopes), -np.inf)
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        points: NDArray[np.float64] = mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)
        largest = np.maximum(largest, reaches.of_points(points, np.eye(3), np.zeros(3)).max(axis=1))
    return largest

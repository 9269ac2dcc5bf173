"""Texture coordinates where rays hit: those of the corners of each face, interpolated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh, Shape
from ...trace.hits.by_geometry import group_by_geometry
from ...trace.hits.hits import Hits

# Hits at a time: the values of their corners stay in the cache.
_CHUNK_HITS = 1 << 14


def find_texture_coordinates(hits: Hits, shapes: Sequence[Shape]) -> NDArray[np.float32]:
    """Return (..., 2) float32: NaN on a miss, and on shapes without texture coordinates.

    Parameters
    ----------
    hits : Hits
    shapes : sequence of Mesh or Spheres
        By the geometry ids of the hits.
    """
    result = np.full((hits.prim_id.size, 2), np.nan, np.float32)
    prims, us, vs = (np.asarray(values).reshape(-1) for values in (hits.prim_id, hits.u, hits.v))
    for geometry, of_geometry in group_by_geometry(np.asarray(hits.geometry_id).reshape(-1)):
        shape = shapes[geometry]
        corners = shape.appearance.uvs if isinstance(shape, Mesh) and shape.appearance is not None else None
        if corners is None:
            continue
        for begin in range(0, len(of_geometry), _CHUNK_HITS):
            rows = of_geometry[begin : begin + _CHUNK_HITS]
            a, b, c = corners[prims[rows]].astype(np.float64).transpose(1, 0, 2)
            result[rows] = a + ((b - a) * us[rows, None] + (c - a) * vs[rows, None])
    return result.reshape(*hits.prim_id.shape, 2)

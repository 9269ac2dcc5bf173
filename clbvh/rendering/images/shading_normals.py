"""The normals that light is computed with: those of a mesh's file, or smooth ones up to a crease angle."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh, Shape
from ...geometry.appearance.smooth_normals import smooth_normals_by_angle
from ...trace.hits.by_geometry import group_by_geometry
from ...trace.hits.hits import Hits
from ...trace.hits.placed_locations import turn_normals

# Hits at a time: their vectors stay in the cache.
_CHUNK_HITS = 1 << 14

# The sum of unit vectors is no direction if its square is smaller: they cancel each other.
_LEAST_SQUARE = 2.0**-40

# The last angle and the smooth normals of meshes that are alive: 36 bytes per face, 0.6 s for a million faces.
_known: WeakKeyDictionary[Mesh, tuple[float, NDArray[np.float32]]] = WeakKeyDictionary()


def find_shading_normals(hits: Hits, shapes: Sequence[Shape], crease_angle: float) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals on the side from which the rays came, NaN on a miss.

    Parameters
    ----------
    hits : Hits
        They know the sides of their rays.
    shapes : sequence of Mesh or Spheres
        By the geometry ids of the hits.
    crease_angle : float
        Degrees. Meshes without normals are smooth over edges that turn by less; 0: over none.
    """
    normals = np.array(hits.normals(facing=True)).reshape(-1, 3)
    prims, us, vs, instances = (
        np.asarray(values).reshape(-1) for values in (hits.prim_id, hits.u, hits.v, hits.instance_id)
    )
    for geometry, of_geometry in group_by_geometry(np.asarray(hits.geometry_id).reshape(-1)):
        shape = shapes[geometry]
        if not isinstance(shape, Mesh):
            continue
        corners = _find_corner_normals(shape, float(crease_angle))
        for begin in range(0, len(of_geometry), _CHUNK_HITS):
            rows = of_geometry[begin : begin + _CHUNK_HITS]
            a, b, c = corners[prims[rows]].astype(np.float64).transpose(1, 0, 2)
            blended = a + ((b - a) * us[rows, None] + (c - a) * vs[rows, None])
            squares = np.einsum("ij,ij->i", blended, blended)
            is_direction = squares > _LEAST_SQUARE
            blended /= np.sqrt(np.where(is_direction, squares, 1.0))[:, None]
            if hits.scene_surface is not None:
                blended = turn_normals(hits.scene_surface.arrays, instances[rows], blended)
            # To the side of the face, on which the ray came: files do not always agree with the order of corners.
            sides = np.einsum("ij,ij->i", blended, normals[rows])
            is_kept = is_direction & (sides != 0) & np.isfinite(sides)
            normals[rows] = np.where(is_kept[:, None], blended * np.sign(sides)[:, None], normals[rows])
    return normals.reshape(*hits.prim_id.shape, 3)


def _find_corner_normals(mesh: Mesh, crease_angle: float) -> NDArray[np.float32]:
    """Return (F, 3, 3) float32: unit normals at the corners of faces."""
    if mesh.appearance is not None and mesh.appearance.normals is not None:
        return mesh.appearance.normals
    angle, normals = _known.get(mesh, (-1.0, None))
    if normals is None or angle != crease_angle:
        normals = smooth_normals_by_angle(mesh, crease_angle)
        _known[mesh] = crease_angle, normals
    return normals

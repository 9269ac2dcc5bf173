"""Normals that change continuously over the faces of a mesh: those of its vertices, interpolated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh, Shape
from ...structs import NO_PRIM
from .by_geometry import group_by_geometry
from .interpolate import interpolate_vertices
from .placed_locations import turn_normals
from .scene_arrays import SceneArrays

# Hits at a time: their vectors stay in the cache.
_CHUNK_HITS = 1 << 14

# The mean of unit vectors is no direction if its square is smaller: they cancel each other.
_LEAST_SQUARE = 2.0**-40


def find_smooth_normals(
    mesh: Mesh,
    prim_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    normals: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (..., 3) float64: interpolated unit normals; see `Normals.__call__`.

    Parameters
    ----------
    mesh : Mesh
    prim_id : (...) int32
    u, v : (...) float
    normals : (..., 3) float64
        Those of the faces, to whose side the result keeps.
    """
    smooth = normals.reshape(-1, 3).copy()
    prims, us, vs = _flatten(prim_id, u, v)
    for hits in _chunks(np.flatnonzero(prims != NO_PRIM)):
        blended = _blend(mesh, prims[hits], us[hits], vs[hits])
        smooth[hits] = _keep_sides(blended, smooth[hits])
    return smooth.reshape(normals.shape)


def find_placed_smooth_normals(
    arrays: SceneArrays,
    shapes: Sequence[Shape],
    prim_id: NDArray[np.int32],
    instance_id: NDArray[np.int32],
    geometry_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    normals: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (..., 3) float64: the same for hits on the instances of a scene, in world coordinates."""
    smooth = normals.reshape(-1, 3).copy()
    prims, us, vs = _flatten(prim_id, u, v)
    instances = np.asarray(instance_id).reshape(-1)
    for geometry, of_geometry in group_by_geometry(np.asarray(geometry_id).reshape(-1)):
        shape = shapes[geometry]
        if not isinstance(shape, Mesh):
            continue
        for hits in _chunks(of_geometry):
            blended = turn_normals(arrays, instances[hits], _blend(shape, prims[hits], us[hits], vs[hits]))
            smooth[hits] = _keep_sides(blended, smooth[hits])
    return smooth.reshape(normals.shape)


def _flatten(
    prim_id: NDArray[np.int32], u: NDArray[np.floating], v: NDArray[np.floating]
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    us, vs = (np.asarray(coordinates, np.float64).reshape(-1) for coordinates in (u, v))
    return np.asarray(prim_id).reshape(-1), us, vs


def _chunks(hits: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    return (hits[begin : begin + _CHUNK_HITS] for begin in range(0, len(hits), _CHUNK_HITS))


def _blend(
    mesh: Mesh, prim_id: NDArray[np.int32], u: NDArray[np.float64], v: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, 3) float64: interpolated vertex normals of length 1; NaN where they have no direction."""
    blended = interpolate_vertices(mesh.vertex_normals, mesh.faces, prim_id, u, v)
    squares = np.einsum("ij,ij->i", blended, blended)
    squares[~(squares > _LEAST_SQUARE)] = np.nan
    blended /= np.sqrt(squares)[:, None]
    return blended


def _keep_sides(blended: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the interpolated normals where they are on the side of the face's own, which replaces the others."""
    # Written so that NaN is on no side.
    is_kept = np.einsum("ij,ij->i", blended, normals) > 0.0
    return np.where(is_kept[:, None], blended, normals)

"""Values at hits: data of vertices, interpolated over the faces, and data of spheres.

The normals of vertices are such data, too: interpolated, they change continuously over the faces.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import QueryError
from ...geometry import Mesh, Shape
from ...geometry.arrays import has_masked_values
from ...structs import NO_PRIM
from ..rays.batch import check_room
from ..world.surface_arrays import SurfaceArrays, SurfacePoints
from .locations import turn_normals


def group_by_geometry(geometry_id: NDArray[np.int32]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield each geometry that occurs, in ascending order, and the ascending indices of its hits; misses are left out.

    Parameters
    ----------
    geometry_id : (n,) int32
        The geometry of each hit; none is -1.
    """
    if len(geometry_id) == 0:
        return
    least, greatest = int(geometry_id.min()), int(geometry_id.max())
    if least == greatest:
        order, begins = np.arange(len(geometry_id)), np.zeros(1, np.int64)
    else:
        order = np.argsort(geometry_id, kind="stable")
        ordered = geometry_id[order]
        begins = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    for hits in np.split(order, begins[1:]):
        geometry = int(geometry_id[hits[0]])
        if geometry != NO_PRIM:
            yield geometry, hits


# Hits at a time: the values of their corners stay in the cache.
_CHUNK_HITS = 1 << 14

_MAX_SHOWN = 60  # characters of a wrong value in a message

Attribute = ArrayLike | Mapping[Any, ArrayLike]


def interpolate(
    shapes: Sequence[Shape],
    names: Sequence[str],
    attribute: Attribute,
    prim_id: NDArray[np.int32],
    geometry_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return the values of an attribute at hits; see `Hits.interpolate`.

    Parameters
    ----------
    shapes, names : sequences
        Of each geometry.
    attribute : (V, k...) array of numbers, or a mapping of geometries to them
    prim_id, geometry_id : (...) int32
    u, v : (...) float
    """
    values = _read_values(shapes, names, attribute)
    widths = {array.shape[1:] for array in values.values()}
    if len(widths) > 1:
        shown = ", ".join(f"{names[geometry]!r}: {array.shape}" for geometry, array in values.items())
        raise QueryError(f"the values of all geometries must have one shape after the first axis, not {shown}")
    width = widths.pop() if widths else ()
    check_room(prim_id.size, 8 * math.prod(width), "hits")
    result = np.full((prim_id.size, *width), np.nan)
    prims, geometries = np.asarray(prim_id).reshape(-1), np.asarray(geometry_id).reshape(-1)
    us, vs = (np.asarray(coordinates, np.float64).reshape(-1) for coordinates in (u, v))
    for geometry, of_geometry in group_by_geometry(geometries):
        if geometry not in values:
            continue
        for begin in range(0, len(of_geometry), _CHUNK_HITS):
            hits = of_geometry[begin : begin + _CHUNK_HITS]
            result[hits] = _values_at(shapes[geometry], values[geometry], prims[hits], us[hits], vs[hits])
    return result.reshape(*prim_id.shape, *width)


def interpolate_vertices(
    values: NDArray[Any],
    faces: NDArray[np.int32],
    prim_id: NDArray[np.int32],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (n, k...) float64: ``a + (u (b - a) + v (c - a))``, as locations are computed from vertices.

    Parameters
    ----------
    values : (V, k...) real numbers
    faces : (F, 3) int32
    prim_id : (n,) int32
        Faces; none is -1.
    u, v : (n,) float64
    """
    corners = faces[prim_id]
    weights = (slice(None), *(None,) * (values.ndim - 1))
    a = values[corners[:, 0]].astype(np.float64)
    result = values[corners[:, 1]].astype(np.float64)
    result -= a
    result *= u[weights]
    to_c = values[corners[:, 2]].astype(np.float64)
    to_c -= a
    to_c *= v[weights]
    result += to_c
    result += a
    return result


def _values_at(
    shape: Shape, values: NDArray[Any], prim_id: NDArray[np.int32], u: NDArray[np.float64], v: NDArray[np.float64]
) -> NDArray[np.float64]:
    if isinstance(shape, Mesh):
        return interpolate_vertices(values, shape.faces, prim_id, u, v)
    return values[prim_id].astype(np.float64)


def _read_values(shapes: Sequence[Shape], names: Sequence[str], attribute: Attribute) -> dict[int, NDArray[Any]]:
    """Return the values of each geometry by its id, checked."""
    if not isinstance(attribute, Mapping):
        if len(shapes) != 1:
            raise QueryError(
                f"the scene has {len(shapes)} geometries: give the values as a mapping, {{geometry: values, ...}}"
            )
        return {0: _read_array(attribute, shapes[0], names[0])}
    values: dict[int, NDArray[Any]] = {}
    for key, array in attribute.items():
        geometry = _find_geometry(key, names)
        if geometry in values:
            raise QueryError(f"the mapping has values for the geometry {names[geometry]!r} twice")
        values[geometry] = _read_array(array, shapes[geometry], names[geometry])
    return values


def _find_geometry(key: Any, names: Sequence[str]) -> int:
    """Return the id of a geometry, which may be given as its handle, its name or its id."""
    if isinstance(key, str):
        if key not in names:
            known = ", ".join(repr(name) for name in names)[:_MAX_SHOWN]
            raise QueryError(f"the scene has no geometry with the name {repr(key)[:_MAX_SHOWN]}, but {known or 'none'}")
        return list(names).index(key)
    number = getattr(key, "id", key)
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise QueryError(f"values are given for geometries, their names or their ids, not for {repr(key)[:_MAX_SHOWN]}")
    if not 0 <= number < len(names):
        raise QueryError(f"the scene has no geometry with the id {number}: there are {len(names)}, counted from 0")
    return int(number)


def _read_array(values: ArrayLike, shape: Shape, name: str) -> NDArray[Any]:
    """Return values of the vertices of a mesh, or of spheres, as an array of real numbers."""
    is_mesh = isinstance(shape, Mesh)
    count = len(shape.vertices) if isinstance(shape, Mesh) else shape.prim_count
    owners = "vertices" if is_mesh else "spheres"
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise QueryError(f"{name}: the values must be an array, but its rows differ in length: {error}") from error
    if has_masked_values(values):
        raise QueryError(f"{name}: the values must be numbers, but some are masked")
    if array.dtype.kind not in "fiub":
        raise QueryError(f"{name}: the values must be real numbers, not {array.dtype}")
    if array.ndim == 0 or len(array) != count:
        raise QueryError(
            f"{name}: there must be one value or row for each of the {count:,} {owners}, not {array.shape}"
        )
    return array


# The mean of unit vectors is no direction if its square is smaller: they cancel each other.
_LEAST_SQUARE = 2.0**-40


def find_smooth_normals(
    arrays: SurfaceArrays,
    shapes: Sequence[Shape],
    points: SurfacePoints,
    geometry_id: NDArray[np.int32],
    normals: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (..., 3) float64: interpolated unit normals; see `Normals.__call__`.

    Parameters
    ----------
    arrays : SurfaceArrays
    shapes : sequence of Mesh or Spheres
        Of each geometry.
    points : SurfacePoints
    geometry_id : (...) int32
    normals : (..., 3) float64
        Those of the faces, to whose side the result keeps.
    """
    smooth = normals.reshape(-1, 3).copy()
    prims, instances = np.asarray(points.prim_id).reshape(-1), np.asarray(points.instance_id).reshape(-1)
    us, vs = (np.asarray(coordinates, np.float64).reshape(-1) for coordinates in (points.u, points.v))
    for geometry, of_geometry in group_by_geometry(np.asarray(geometry_id).reshape(-1)):
        shape = shapes[geometry]
        if not isinstance(shape, Mesh):
            continue
        for hits in _chunks(of_geometry):
            blended = turn_normals(arrays, instances[hits], _blend(shape, prims[hits], us[hits], vs[hits]))
            smooth[hits] = _keep_sides(blended, smooth[hits])
    return smooth.reshape(normals.shape)


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

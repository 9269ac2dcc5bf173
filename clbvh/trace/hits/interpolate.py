"""Values at hits: data of vertices, interpolated over the faces, and data of spheres."""

from __future__ import annotations

import itertools
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
from ..world.surface_arrays import SurfacePoints

# Hits at a time: the values of their corners stay in the cache.
_CHUNK_HITS = 1 << 14

_MAX_SHOWN = 60  # characters of a wrong value in a message

Attribute = ArrayLike | Mapping[Any, ArrayLike]


def group_by_geometry(geometry_id: NDArray[np.int32]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield each geometry that occurs, in ascending order, and the ascending indices of a chunk of its hits.

    Parameters
    ----------
    geometry_id : (n,) int32
        The geometry of each hit; -1 for a miss, which is left out.
    """
    order = np.argsort(geometry_id, kind="stable")
    ordered = geometry_id[order]
    # The least id is that of misses.
    begins = np.flatnonzero(np.diff(ordered, prepend=np.int32(NO_PRIM)))
    for begin, end in itertools.pairwise([*begins.tolist(), len(order)]):
        for first in range(begin, end, _CHUNK_HITS):
            yield int(ordered[begin]), order[first : min(first + _CHUNK_HITS, end)]


def interpolate(
    shapes: Sequence[Shape],
    names: Sequence[str],
    attribute: Attribute,
    points: SurfacePoints,
    geometry_id: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Return the values of an attribute at hits; see `Hits.interpolate`.

    Parameters
    ----------
    shapes, names : sequences
        Of each geometry.
    attribute : (V, k...) array of numbers, or a mapping of geometries to them
    points : SurfacePoints of (...)
    geometry_id : (...) int32
    """
    values = _read_values(shapes, names, attribute)
    widths = {array.shape[1:] for array in values.values()}
    if len(widths) > 1:
        shown = ", ".join(f"{names[geometry]!r}: {array.shape}" for geometry, array in values.items())
        raise QueryError(f"the values of all geometries must have one shape after the first axis, not {shown}")
    width = widths.pop() if widths else ()
    check_room(geometry_id.size, 8 * math.prod(width), "hits")
    result = np.full((geometry_id.size, *width), np.nan)
    prims, _, us, vs = points.flat()
    for geometry, hits in group_by_geometry(geometry_id.reshape(-1)):
        shape, of_prims = shapes[geometry], values.get(geometry)
        if of_prims is None:
            continue
        if isinstance(shape, Mesh):
            result[hits] = interpolate_vertices(of_prims, shape.faces, prims[hits], us[hits], vs[hits])
        else:
            result[hits] = of_prims[prims[hits]]
    return result.reshape(*geometry_id.shape, *width)


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
    count, owners = shape.prim_count, shape.kind.name
    if isinstance(shape, Mesh):
        count, owners = len(shape.vertices), "vertices"
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

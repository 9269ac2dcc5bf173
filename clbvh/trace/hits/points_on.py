"""Points on a surface that no ray has found, as hits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import QueryError
from ...scene.handles import shorten
from .hits import Hits
from .surface import Surface

# Barycentric coordinates of others are rounded; those that miss by more are not of this triangle.
_MOST_BARYCENTRIC_ERROR = 1e-6


def place_points(
    surface: Surface, prim_id: ArrayLike, barycentrics: ArrayLike, instance_ids: NDArray[np.int64] | None = None
) -> Hits:
    """Return points on a surface as hits; see `Tracer.points_on`."""
    ids, weights, owners = np.asarray(prim_id), np.asarray(barycentrics), surface.arrays.geometry_id
    if instance_ids is None and len(owners) != 1:
        raise QueryError(f"instance must say on which of the {len(owners)} instances the faces are")
    expected = (
        f"barycentrics must be the weights of points on triangles, (..., 3) or (..., 2), not {shorten(barycentrics)}"
    )
    if weights.dtype.kind not in "iuf" or weights.shape[-1:] not in ((2,), (3,)):
        raise QueryError(expected)
    u, v = weights[..., -2].astype(np.float64), weights[..., -1].astype(np.float64)
    misses = np.minimum(np.minimum(u, v), 1 - u - v)
    if weights.shape[-1] == 3:
        misses = np.minimum(misses, -np.abs(weights[..., 0] + u + v - 1))
    if not (misses >= -_MOST_BARYCENTRIC_ERROR).all():
        raise QueryError(expected)
    instances = np.zeros(1, np.int64) if instance_ids is None else instance_ids
    instances = instances[0] if len(instances) == 1 else instances
    counts = np.array([shape.prim_count for shape in surface.shapes] or [0])[owners[instances]]
    most = np.max(counts, initial=0)
    try:
        ids, u, v, instances, counts = np.broadcast_arrays(ids, u, v, instances, counts)
    except ValueError:
        shapes = f"prim_id {ids.shape} and barycentrics {weights.shape}"
        raise QueryError(f"{shapes} do not broadcast" + f" with {instances.shape} instances" * instances.ndim) from None
    if ids.dtype.kind not in "iu" or ((ids < 0) | (ids >= counts)).any():
        raise QueryError(f"prim_id must be whole numbers from 0 to {most - 1}, not {shorten(prim_id)}")
    known = None if surface.arrays.is_lone else instances.astype(np.int32)
    return Hits(np.zeros(ids.shape), u, v, ids.astype(np.int32), surface=surface, known_instance_id=known)

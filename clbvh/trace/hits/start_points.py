"""Start points of rays that leave a mesh at points that no ray has found."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import QueryError
from ...geometry import MeshLike, as_mesh
from ...scene.handles import shorten
from .hits import Hits

# Barycentric coordinates of others are rounded; those that miss by more are not of this triangle.
_MOST_BARYCENTRIC_ERROR = 1e-6


def offset_points(
    mesh: MeshLike, face_ids: ArrayLike, barycentrics: ArrayLike, towards: ArrayLike
) -> NDArray[np.float64]:
    """Return start points for rays that leave a mesh at any points of its surface: sun hours, thickness, visibility.

    The same as `Hits.offset_origins` for points that no ray has found, such as random ones or centroids.

    Parameters
    ----------
    mesh : Mesh, trimesh.Trimesh, str, path or (vertices, faces)
        At which the rays are to be cast, in its own place.
    face_ids : (...,) int
    barycentrics : (..., 3) float, or (..., 2)
        Weights of the corners a, b and c, of sum 1, as `trimesh.triangles.points_to_barycentric` returns them; or u and
        v of `Hits`, the last two of them.
    towards : (..., 3) float
        Directions of the rays, of any length above 0: each start point is on the side to which its direction leads.

    Returns
    -------
    (..., 3) float64, the file's coordinates
        The leading shapes of the arguments, broadcast. NaN on a face whose corners are one point.

    Raises
    ------
    MeshError
        The mesh cannot be used.
    QueryError
        A face that the mesh does not have, weights that are not of a point on a triangle, shapes that do not broadcast,
        or a direction that is not finite or has length zero.

    Notes
    -----
    See `Hits.offset_origins` for what such a ray can meet: never its own triangle.

    Examples
    --------
    Which share of the surface sees the sun:

    >>> import clbvh
    >>> import numpy as np
    >>> knot, sun = clbvh.make_shape("knot", triangles=2000), [0, 1, 3]
    >>> points = clbvh.offset_points(knot, np.arange(knot.face_count), [1 / 3, 1 / 3, 1 / 3], sun)
    >>> with clbvh.Tracer(knot) as tracer:
    ...     in_light = (knot.face_normals @ sun > 0) & ~tracer.any_hit(points, sun)
    >>> round(in_light.mean().item(), 2)
    0.42
    """
    mesh = as_mesh(mesh)
    ids, weights = np.asarray(face_ids), np.asarray(barycentrics)
    if ids.dtype.kind not in "iu" or ((ids < 0) | (ids >= mesh.face_count)).any():
        raise QueryError(f"face_ids must be whole numbers from 0 to {mesh.face_count - 1}, not {shorten(face_ids)}")
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
    try:
        ids, u, v = np.broadcast_arrays(ids.astype(np.int32), u, v)
    except ValueError:
        raise QueryError(f"face_ids {ids.shape} and barycentrics {weights.shape} do not broadcast") from None
    return Hits(np.zeros(ids.shape), u, v, ids, mesh=mesh).offset_origins(towards=towards)

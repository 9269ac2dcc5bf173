"""How thick a mesh is, and how much room there is around it: rays, and spheres that touch the surface twice.

Names, arguments, defaults and dtypes are those of `trimesh.proximity` in trimesh 5; `reach` is new.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh.constants import tol

from ...errors import ConfigError, QueryError
from .proximity import closest_point
from .ray import read_points
from .tracers import find_tracer, options_for, read_mesh

# Most numbers in a temporary array with one for each pair of a vertex and a ray.
_CHUNK = 1 << 22


def longest_ray(mesh: Any, points: ArrayLike, directions: ArrayLike) -> NDArray[np.float64]:
    """Return (n,) float64: how far rays go before they meet the mesh, infinite for those that never do.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
    points, directions : (n, 3) float
        Directions of any length. What is nearer than ``trimesh.tol.planar`` does not count: it is the surface that
        the ray starts from.

    Raises
    ------
    QueryError
        A wrong shape.
    MeshError
        The argument is not a mesh, or has no faces.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import longest_ray
    >>> longest_ray(trimesh.creation.box(), [[0, 0, 0], [0, 0, 0.5]], [[1, 0, 0], [0, 0, 1]])
    array([0.5, inf])
    """
    mesh = read_mesh(mesh)
    origins, ways = read_points(points), _read_vectors(directions, points, "directions")
    distance = np.full(len(origins), np.inf)
    hits = find_tracer(mesh, options_for(mesh), keep=True).cast(mesh, "all_hits", (origins, ways))
    lengths = hits.t * np.linalg.norm(ways, axis=1)[hits.ray_id]
    is_far = lengths > tol.planar
    np.minimum.at(distance, hits.ray_id[is_far], lengths[is_far])
    return distance


def max_tangent_sphere(
    mesh: Any,
    points: ArrayLike,
    inwards: bool = True,
    normals: ArrayLike | None = None,
    threshold: float = 1e-6,
    max_iter: int = 100,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest spheres that touch a mesh at points of its surface and hold no part of it.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
    points : (n, 3) float
        On the surface.
    inwards : bool
        Whether the spheres are inside.
    normals : (n, 3) float, optional
        Unit normals at the points; those of the closest faces without it.
    threshold : float
        A radius that shrinks by less than this share of the box's diagonal is final.
    max_iter : int

    Returns
    -------
    centers : (n, 3) float64
        NaN where the sphere has no bound.
    radii : (n,) float64
        Infinite there.

    Raises
    ------
    QueryError
        A wrong shape, or a value that is not finite.
    MeshError
        The argument is not a mesh, or has no faces.

    Notes
    -----
    Masatomo Inui, Nobuyuki Umezu, Ryohei Shimane, "Shrinking sphere: a parallel algorithm for computing the thickness
    of 3D objects" (2016): a sphere begins too large and shrinks until it touches the surface point nearest to its
    centre.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import max_tangent_sphere
    >>> centers, radii = max_tangent_sphere(trimesh.creation.box(), [[0, 0, 0.5]])
    >>> radii.round(6)
    array([0.5])
    """
    mesh = read_mesh(mesh)
    starts = read_points(points)
    ways = _read_normals(mesh, starts, normals)
    if inwards:
        ways = -ways

    # The first spheres reach to the opposite side, or to the vertex that is highest above the tangent plane.
    opposite = longest_ray(mesh, starts, ways)
    radii = opposite / 2
    is_open = np.isinf(opposite)
    radii[is_open] = _radii_to_highest(np.asarray(mesh.vertices), starts[is_open], ways[is_open])
    centers = np.full((len(starts), 3), np.nan)
    shrinking = np.flatnonzero(np.isfinite(radii))
    centers[shrinking] = starts[shrinking] + ways[shrinking] * radii[shrinking, None]

    least_change = threshold * np.linalg.norm(np.ptp(mesh.bounds, axis=0))
    for _ in range(max_iter):
        # Spheres whose centre is as near to another point of the surface as to their own touch it there.
        nearest, distance, _ = closest_point(mesh, centers[shrinking])
        own = np.linalg.norm(centers[shrinking] - starts[shrinking], axis=1)
        is_inside = np.abs(distance - own) >= tol.planar
        shrinking, chords = shrinking[is_inside], (nearest - starts[shrinking])[is_inside]

        # The others shrink to the sphere through that point.
        with np.errstate(divide="ignore", invalid="ignore"):
            smaller = (chords**2).sum(axis=1) / (2 * (chords * ways[shrinking]).sum(axis=1))
        is_sphere = np.isfinite(smaller)
        shrinking, smaller = shrinking[is_sphere], smaller[is_sphere]
        change = radii[shrinking] - smaller
        radii[shrinking] = smaller
        centers[shrinking] = starts[shrinking] + ways[shrinking] * smaller[:, None]
        shrinking = shrinking[change >= least_change]
        if len(shrinking) == 0:
            break
    return centers, radii


def thickness(
    mesh: Any,
    points: ArrayLike,
    exterior: bool = False,
    normals: ArrayLike | None = None,
    method: str = "max_sphere",
) -> NDArray[np.float64]:
    """Return (n,) float64: how thick a mesh is at points of its surface.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
    points : (n, 3) float
        On the surface.
    exterior : bool
        Whether to measure the room outside instead; see `reach`.
    normals : (n, 3) float, optional
        Unit normals at the points; those of the closest faces without it.
    method : str
        ``"max_sphere"``: the diameter of `max_tangent_sphere`. ``"ray"``: the length of `longest_ray`.

    Raises
    ------
    ConfigError
        An unknown method.
    QueryError
        A wrong shape, or a value that is not finite.
    MeshError
        The argument is not a mesh, or has no faces.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import thickness
    >>> thickness(trimesh.creation.box(), [[0, 0, 0.5]]).round(6)
    array([1.])
    """
    if method not in ("max_sphere", "ray"):
        raise ConfigError(f"method must be 'max_sphere' or 'ray', not {method!r}")
    mesh = read_mesh(mesh)
    starts = read_points(points)
    ways = _read_normals(mesh, starts, normals)
    if method == "ray":
        return longest_ray(mesh, starts, ways if exterior else -ways)
    return 2 * max_tangent_sphere(mesh, starts, inwards=not exterior, normals=ways)[1]


def reach(
    mesh: Any, points: ArrayLike, normals: ArrayLike | None = None, method: str = "max_sphere"
) -> NDArray[np.float64]:
    """Return (n,) float64: the free space outside of a mesh at points of its surface, infinite where it is unbounded.

    The same as `thickness` with ``exterior=True``. trimesh uses the name, but has no function for it.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import reach
    >>> reach(trimesh.creation.box(), [[0, 0, 0.5]])
    array([inf])
    """
    return thickness(mesh, points, exterior=True, normals=normals, method=method)


def _read_normals(mesh: Any, points: NDArray[np.float64], normals: ArrayLike | None) -> NDArray[np.float64]:
    if normals is not None:
        return _read_vectors(normals, points, "normals")
    return np.asarray(mesh.face_normals)[closest_point(mesh, points)[2]]


def _read_vectors(vectors: ArrayLike, points: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return (n, 3) float64, one for each point, or raise `QueryError`."""
    array = read_points(vectors, name)
    if len(array) != len(np.asarray(points)):
        raise QueryError(f"{name} must be as many as the {len(np.asarray(points))} points, not {len(array)}")
    return array


def _radii_to_highest(
    vertices: NDArray[Any], points: NDArray[np.float64], ways: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the radius of the sphere through the vertex that is highest above each tangent plane; infinite if none."""
    radii = np.full(len(points), np.inf)
    # About their middle, so that vertices far from zero lose no digits.
    middle = vertices.mean(axis=0)
    step = max(1, _CHUNK // len(vertices))
    for begin in range(0, len(points), step):
        chunk = slice(begin, begin + step)
        highest = ((vertices - middle) @ ways[chunk].T).argmax(axis=0)
        chords = vertices[highest] - points[chunk]
        height = (chords * ways[chunk]).sum(axis=1)
        is_above = height >= tol.planar
        radii[chunk][is_above] = (chords[is_above] ** 2).sum(axis=1) / (2 * height[is_above])
    return radii

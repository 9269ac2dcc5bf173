"""Rays at a `pyvista.PolyData`, with the arguments and the answers of its own methods; embree is not needed.

pyvista is imported to install them and to plot. See docs/coming-from.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MeshError
from ..geometry.as_mesh import as_mesh
from ..support.opened import digest_of, open_once
from ..trace.hits.closest import NO_LIMIT
from .trimesh.ray import RayMeshIntersector, read_points

__all__ = ["find_cell_ids", "install", "multi_ray_trace", "ray_trace", "uninstall"]

# Cell data of a copy: the cells that triangles come from.
_CELL_IDS = "clbvh cell ids"


def multi_ray_trace(
    mesh: Any, origins: ArrayLike, directions: ArrayLike, first_point: bool = False, retry: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return where rays hit a mesh of pyvista; as `pyvista.PolyDataFilters.multi_ray_trace` does.

    Parameters
    ----------
    mesh : pyvista.PolyData
        Of any polygons, where pyvista takes triangles only. The trees of the two meshes that were used last are kept,
        by their content.
    origins, directions : (n, 3) float
        Directions of any length. Rays without direction, or that are not finite, hit nothing.
    first_point : bool
        The first hit of each ray only.
    retry : bool
        Orders hits by ray, as pyvista's does. No ray needs a second attempt.

    Returns
    -------
    points : (m, 3) float64
        The first hits of all rays in the order of the rays, then all second hits, and so on. With `retry`, all hits of
        the first ray in their order along it, then those of the second, and so on.
    rays : (m,) int64
    cells : (m,) int64
        Indices of cells of the mesh as it was given: of a quad, whichever of its triangles is hit.

    Raises
    ------
    MeshError
        The mesh has no `points` and `faces` of pyvista, or they are no valid mesh.
    QueryError
        Origins and directions are not arrays of one shape (n, 3).

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from clbvh.integrations.pyvista import multi_ray_trace
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> triangle = SimpleNamespace(points=corners, faces=np.array([3, 0, 1, 2]), is_all_triangles=True)  # a PolyData
    >>> points, rays, cells = multi_ray_trace(triangle, [[9, 9, 2], [0.25, 0.5, 2]], [[0, 0, -1]] * 2)
    >>> points, rays, cells
    (array([[0.25, 0.5 , 0.  ]]), array([1]), array([0]))
    """
    cell_ids, engine = _open(mesh)
    triangles, rays, points = engine.intersects_id(
        origins, directions, multiple_hits=not first_point, max_hits=NO_LIMIT, return_locations=True
    )
    if retry:
        order = np.argsort(rays, kind="stable")
        points, rays, triangles = points[order], rays[order], triangles[order]
    return points, rays, cell_ids[triangles]


def ray_trace(
    mesh: Any,
    origin: ArrayLike,
    end_point: ArrayLike,
    first_point: bool = False,
    plot: bool = False,
    off_screen: bool | None = None,
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """Return where a line segment hits a mesh of pyvista; as `pyvista.PolyDataFilters.ray_trace` does.

    Parameters
    ----------
    mesh : pyvista.PolyData
        As of `multi_ray_trace`, which takes far less time for many rays: each call hashes the mesh.
    origin, end_point : (3,) float
        Both count. Equal ones, or that are not finite, hit nothing.
    first_point : bool
        Return the first point only, as (3,), but the cells of all, as pyvista does.
    plot, off_screen : bool
        To plot is left to pyvista's own method.

    Returns
    -------
    points : (m, 3) float, of the dtype of the mesh's points
        In their order along the segment, each once.
    cells : (m,) int64
        Indices of cells of the mesh as it was given.

    Raises
    ------
    MeshError
        As of `multi_ray_trace`.
    QueryError
        Origin or end point is not of shape (3,).

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from clbvh.integrations.pyvista import ray_trace
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> triangle = SimpleNamespace(points=corners, faces=np.array([3, 0, 1, 2]), is_all_triangles=True)  # a PolyData
    >>> ray_trace(triangle, [0.25, 0.5, 2], [0.25, 0.5, -2])
    (array([[0.25, 0.5 , 0.  ]]), array([0]))
    """
    if plot:
        import pyvista

        own: Any = super(pyvista.PolyData, mesh)
        return own.ray_trace(origin, end_point, first_point=first_point, plot=plot, off_screen=off_screen)
    cell_ids, engine = _open(mesh)
    begin = read_points(np.asarray(origin)[None], "origin")
    end = read_points(np.asarray(end_point)[None], "end_point")
    hits = engine._cast("all_hits", (begin, end - begin), t_max=1.0, with_locations=True)
    hits = hits[np.unique(hits.t, return_index=True)[1]]
    points = hits.locations.astype(np.asarray(mesh.points).dtype)
    return points[0] if first_point and len(points) else points, cell_ids[hits.prim_id]


def find_cell_ids(mesh: Any) -> NDArray[np.int64]:
    """Return (F,) int64: the cell of a `pyvista.PolyData` that each triangle of a tracer over it comes from.

    Raises
    ------
    MeshError
        The mesh has no `points` and `faces` of pyvista.

    Examples
    --------
    >>> import clbvh
    >>> import pyvista  # doctest: +SKIP
    >>> from clbvh.integrations.pyvista import find_cell_ids
    >>> box = pyvista.Box()  # doctest: +SKIP
    >>> hit = clbvh.Tracer(box).closest_hit([0, 0.1, 5], [0, 0, -1])  # doctest: +SKIP
    >>> find_cell_ids(box)[hit.prim_id]  # of its 6 quads  # doctest: +SKIP
    np.int64(5)
    """
    if not all(hasattr(mesh, name) for name in ("points", "faces", "is_all_triangles")):
        raise MeshError(f"expected a pyvista.PolyData, not a {type(mesh).__name__}: take its surface first")
    if mesh.is_all_triangles:
        return np.arange(len(mesh.faces) // 4)
    numbered = mesh.copy(deep=False)
    numbered.cell_data[_CELL_IDS] = np.arange(mesh.n_cells)
    surface = numbered.triangulate()
    # Cells of points and lines, if any are left, come first.
    return np.asarray(surface.cell_data[_CELL_IDS])[surface.n_verts + surface.n_lines :]


def _open(mesh: Any) -> tuple[NDArray[np.int64], RayMeshIntersector]:
    """Return the cells that the triangles of a mesh of pyvista come from, and an engine for it, once per content."""
    arrays = [np.asarray(getattr(mesh, name, ())) for name in ("points", "faces", "strips", "verts", "lines")]
    return open_once(digest_of(arrays), lambda: (find_cell_ids(mesh), RayMeshIntersector(as_mesh(mesh))))


_METHODS = ray_trace, multi_ray_trace


def install() -> None:
    """Make `ray_trace` and `multi_ray_trace` the methods of every `pyvista.PolyData` of the process.

    Examples
    --------
    >>> import pyvista  # doctest: +SKIP
    >>> from clbvh.integrations.pyvista import install
    >>> install()  # doctest: +SKIP
    >>> points, cells = pyvista.Sphere().ray_trace([0, 0, 5], [0, 0, -5])  # doctest: +SKIP
    """
    import pyvista

    for method in _METHODS:  # in front of those that it inherits
        setattr(pyvista.PolyData, method.__name__, method)


def uninstall() -> None:
    """Restore pyvista's own methods; do nothing if they are there.

    Examples
    --------
    >>> from clbvh.integrations.pyvista import uninstall
    >>> uninstall()  # doctest: +SKIP
    """
    import pyvista

    for method in _METHODS:
        if vars(pyvista.PolyData).get(method.__name__) is method:
            delattr(pyvista.PolyData, method.__name__)

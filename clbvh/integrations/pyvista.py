"""Rays at a `pyvista.PolyData`, with the arguments and the answers of its own `multi_ray_trace`; embree is not needed.

pyvista is imported by `install` alone. See docs/coming-from.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MeshError
from ..geometry.as_mesh import as_mesh
from ..support.opened import digest_of, open_once
from ..trace.hits.closest import NO_LIMIT
from .trimesh.ray import RayMeshIntersector

__all__ = ["install", "multi_ray_trace", "uninstall"]

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
    if not all(hasattr(mesh, name) for name in ("points", "faces", "is_all_triangles")):
        raise MeshError(f"expected a pyvista.PolyData, not a {type(mesh).__name__}: take its surface first")
    arrays = [np.asarray(getattr(mesh, name, ())) for name in ("points", "faces", "strips", "verts", "lines")]
    engine, cell_ids = open_once(digest_of(arrays), lambda: _open(mesh))
    triangles, rays, points = engine.intersects_id(
        origins, directions, multiple_hits=not first_point, max_hits=NO_LIMIT, return_locations=True
    )
    if retry:
        order = np.argsort(rays, kind="stable")
        points, rays, triangles = points[order], rays[order], triangles[order]
    return points, rays, cell_ids[triangles]


def _open(mesh: Any) -> tuple[RayMeshIntersector, NDArray[np.int64]]:
    """Return an engine for a mesh of pyvista, and the cells that its triangles come from."""
    if mesh.is_all_triangles:
        return RayMeshIntersector(as_mesh(mesh)), np.arange(len(mesh.faces) // 4)
    numbered = mesh.copy(deep=False)
    numbered.cell_data[_CELL_IDS] = np.arange(mesh.n_cells)
    surface = numbered.triangulate()
    # Cells of points and lines, if any are left, come first.
    cell_ids = np.asarray(surface.cell_data[_CELL_IDS])[surface.n_verts + surface.n_lines :]
    return RayMeshIntersector(as_mesh(surface)), cell_ids


def install() -> None:
    """Make `multi_ray_trace` the method of every `pyvista.PolyData` of the process.

    Examples
    --------
    >>> import pyvista  # doctest: +SKIP
    >>> from clbvh.integrations.pyvista import install
    >>> install()  # doctest: +SKIP
    >>> points, rays, cells = pyvista.Sphere().multi_ray_trace([[0, 0, 5]], [[0, 0, -1]])  # doctest: +SKIP
    """
    import pyvista

    pyvista.PolyData.multi_ray_trace = multi_ray_trace  # in front of the method that it inherits


def uninstall() -> None:
    """Restore pyvista's own `multi_ray_trace`; do nothing if it is there.

    Examples
    --------
    >>> from clbvh.integrations.pyvista import uninstall
    >>> uninstall()  # doctest: +SKIP
    """
    import pyvista

    if vars(pyvista.PolyData).get("multi_ray_trace") is multi_ray_trace:
        del pyvista.PolyData.multi_ray_trace

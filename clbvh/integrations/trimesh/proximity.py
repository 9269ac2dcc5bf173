"""Distances from points to a mesh: `trimesh.proximity` without rtree, scipy or embree.

Names, arguments, defaults, dtypes and signs are those of trimesh 5. There are two differences: no points give empty
arrays, where trimesh fails; and at equal distance the face is chosen among all faces around the closest point, where
trimesh considers two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from trimesh.constants import tol

from ...device.info import DeviceInfo
from ...errors import QueryError
from ...trace.points.refine import ClosestPoints
from ...trace.tracer import Tracer
from .nearest import choose_facing, find_nearest_vertices
from .ray import RayMeshIntersector, read_points
from .tracers import EngineOptions, Followed, FollowingTracer, find_tracer, options_for, read_mesh, read_options


class ProximityQuery:
    """Proximity queries of a mesh on an OpenCL device: assign it to ``mesh.nearest``.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
        A `trimesh.Trimesh` may change later, see `RayMeshIntersector`, with which it shares the tree.
    device : DeviceInfo, str, int or None
    layout : str
        As for `clbvh.Tracer`. Without either, those of ``mesh.ray`` if that is a `RayMeshIntersector`, then those of
        `install`.

    Raises
    ------
    MeshError
        The argument is not a mesh.
    ConfigError
        An unknown layout, or a device of another type.

    Notes
    -----
    The tree stays on the device until the mesh is collected, or `close`.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import ProximityQuery
    >>> mesh = trimesh.creation.box()
    >>> mesh.nearest = ProximityQuery(mesh)
    >>> mesh.nearest.signed_distance([[0, 0, 0.4], [0, 0, 2]]).round(6)
    array([ 0.1, -1.5])
    """

    def __init__(self, mesh: Any, *, device: DeviceInfo | str | int | None = None, layout: str = "auto") -> None:
        self._mesh = read_mesh(mesh)
        self._options = read_options(device, layout)

    def on_surface(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return the closest point of the surface for each point; see `closest_point`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import ProximityQuery
        >>> point, distance, triangle_id = ProximityQuery(trimesh.creation.box()).on_surface([[0.1, 0.2, 2]])
        >>> point, distance
        (array([[0.1, 0.2, 0.5]]), array([1.5]))
        """
        closest = self._find_closest(read_points(points))
        return closest.point, closest.distance, closest.prim_id.astype(np.int64)

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return (n,) float64: the distance to the surface, positive inside; see the function of this name.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import ProximityQuery
        >>> ProximityQuery(trimesh.creation.box()).signed_distance([[0, 0, 0.25], [0, 0, 2]])
        array([ 0.25, -1.5 ])
        """
        mesh, vectors = self._mesh, read_points(points)
        closest = self._find_closest(vectors)
        doubled = self._find_tracer().ask(mesh, lambda _, known: known.mesh.coincidence.faces)
        distance = closest.distance.copy()
        away = np.flatnonzero(distance > tol.merge)

        # Points over the interior of their closest face: on the side of its normal.
        prim_id = closest.prim_id[away]
        normals = mesh.face_normals[prim_id]
        with np.errstate(over="ignore", invalid="ignore"):  # of points so far away that their squares overflow
            height = ((vectors[away] - closest.point[away]) * normals).sum(axis=1)
            feet = vectors[away] - normals * height[:, None]
            weights = trimesh.triangles.points_to_barycentric(mesh.triangles[prim_id], feet)
        is_over = ((weights >= -tol.merge) & (weights <= 1 + tol.merge)).all(axis=1)
        is_over &= ~np.isin(prim_id, doubled)
        distance[away[is_over]] *= -np.sign(height[is_over])

        # The others are nearest to an edge or a vertex, or to faces that coincide, perhaps with opposite normals.
        beside = away[~is_over]
        if len(beside):
            engine = RayMeshIntersector(mesh, **self._found_options()._asdict())
            distance[beside] *= np.where(engine.contains_points(vectors[beside]), 1.0, -1.0)
        return distance

    def vertex(self, points: ArrayLike) -> tuple[Any, Any]:
        """Return the nearest vertex of the mesh for each point, without scipy.

        Parameters
        ----------
        points : (..., 3) float

        Returns
        -------
        distance : (...,) float64, or float for one point
        vertex_id : (...,) int64, or int for one point
            Index of ``mesh.vertices``, those of no face included; at equal distance the smallest.

        Raises
        ------
        QueryError
            Wrong shape, or a point that is not finite.

        Notes
        -----
        On the host, by a traversal of the tree, exact in float64.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import ProximityQuery
        >>> distance, vertex_id = ProximityQuery(trimesh.creation.box()).vertex([[0.5, 0.5, 2.5]])
        >>> distance
        array([2.])
        """
        given = np.asanyarray(points, dtype=np.float64)
        if given.shape[-1:] != (3,):
            raise QueryError(f"points must be (..., 3), not of shape {given.shape}")
        flat = given.reshape(-1, 3)
        bad = np.flatnonzero(~np.isfinite(flat).all(axis=1))
        if len(bad):
            raise QueryError(f"points[{bad[0]}] is not finite: {flat[bad[0]]}")
        if len(self._mesh.faces):
            tree = self._find_tracer().find_tree(self._mesh)
            distance, vertex_id = find_nearest_vertices(tree, flat)
        else:
            distance, vertex_id = _nearest_of_few(np.asarray(self._mesh.vertices), flat)
        if given.ndim == 1:
            return float(distance[0]), int(vertex_id[0])
        return distance.reshape(given.shape[:-1]), vertex_id.reshape(given.shape[:-1])

    def close(self) -> None:
        """Give the device's memory back, after the queries of other threads; the next query takes it again."""
        self._find_tracer().close()

    def _find_closest(self, points: NDArray[np.float64]) -> ClosestPoints:
        """Return the closest points on the faces that trimesh chooses."""

        def find(tracer: Tracer, known: Followed) -> ClosestPoints:
            closest = tracer.closest_point(points)
            choose_facing(points, known.mesh, known.corner_faces, tol.merge, closest)
            return closest

        return self._find_tracer().ask(self._mesh, find)

    def _find_tracer(self) -> FollowingTracer:
        return find_tracer(self._mesh, self._found_options(), keep=True)

    def _found_options(self) -> EngineOptions:
        return options_for(self._mesh) if self._options == EngineOptions() else self._options

    def __repr__(self) -> str:
        device, layout = self._found_options()
        return f"clbvh.ProximityQuery({self._mesh!r}, device={device!r}, layout={layout!r})"


def closest_point(mesh: Any, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the closest point of a mesh's surface for each point.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
    points : (n, 3) float

    Returns
    -------
    closest : (n, 3) float64
    distance : (n,) float64
    triangle_id : (n,) int64
        Of several faces at the same distance, as far as ``trimesh.tol.merge`` tells, the one whose normal points to
        the point most directly. Degenerate faces have no closest point.

    Raises
    ------
    QueryError
        Points of a wrong shape, or that are not finite.
    MeshError
        The argument is not a mesh, or has no faces.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import closest_point
    >>> closest, distance, triangle_id = closest_point(trimesh.creation.box(), [[0.1, 0.2, 1.5]])
    >>> closest.round(6), distance.round(6)
    (array([[0.1, 0.2, 0.5]]), array([1.]))
    """
    return ProximityQuery(mesh).on_surface(points)


def signed_distance(mesh: Any, points: ArrayLike) -> NDArray[np.float64]:
    """Return (n,) float64: the distance to a mesh's surface, positive inside, negative outside.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
    points : (n, 3) float

    Raises
    ------
    QueryError
        Points of a wrong shape, or that are not finite.
    MeshError
        The argument is not a mesh, or has no faces.

    Notes
    -----
    As in trimesh, a point above or below the interior of its closest face is outside if that face's normal points
    towards it, so the side is defined near open meshes, too. The sign of the others, and near faces that coincide, is
    that of `RayMeshIntersector.contains_points`. Up to ``trimesh.tol.merge`` from the surface the distance is positive.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import signed_distance
    >>> signed_distance(trimesh.creation.box(), [[0, 0, 0.4], [0, 0, 2]]).round(6)
    array([ 0.1, -1.5])
    """
    return ProximityQuery(mesh).signed_distance(points)


def _nearest_of_few(vertices: NDArray[Any], points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the nearest vertices of a mesh that has no faces, and so no tree."""
    if len(vertices) == 0:
        raise QueryError("a mesh without vertices has no nearest one: give the mesh vertices first")
    vertex_id = np.array([np.linalg.norm(vertices - point, axis=1).argmin() for point in points], np.int64)
    return np.linalg.norm(vertices[vertex_id] - points, axis=1), vertex_id

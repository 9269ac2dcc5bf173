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

from ...bvh import Bvh
from ...device.info import DeviceInfo
from ...errors import QueryError
from ...geometry import Mesh
from ...geometry.appearance.normals import VertexFaces
from ...structs import NO_PRIM, NODE_LANES, NODE_MAX
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ...trace.hits.scene_arrays import triangles_of
from ...trace.points.refine import ClosestPoints, closest_on_triangle
from ...trace.tracer import Tracer
from .following_tracer import EngineOptions, read_options
from .ray import RayMeshIntersector
from .tracers import FollowedTree, MeshTracer, find_tracer, options_for, read_mesh


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
        closest = _closest_point(self._mesh, self._found_options(), points)
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
        return _signed_distance(self._mesh, self._found_options(), points)

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
            tree = _kept_tracer(self._mesh, self._found_options()).find_tree(self._mesh)
            distance, vertex_id = find_nearest_vertices(tree, flat)
        else:
            distance, vertex_id = _nearest_of_few(np.asarray(self._mesh.vertices), flat)
        if given.ndim == 1:
            return float(distance[0]), int(vertex_id[0])
        return distance.reshape(given.shape[:-1]), vertex_id.reshape(given.shape[:-1])

    def close(self) -> None:
        """Give the device's memory back, after the queries of other threads; the next query takes it again.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import ProximityQuery
        >>> query = ProximityQuery(trimesh.creation.box())
        >>> query.close()
        """
        _kept_tracer(self._mesh, self._found_options()).close()

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
    towards it, so the side is defined near open meshes, too. The sign of the others is that of
    `RayMeshIntersector.contains_points`. Up to ``trimesh.tol.merge`` from the surface the distance is positive.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import signed_distance
    >>> signed_distance(trimesh.creation.box(), [[0, 0, 0.4], [0, 0, 2]]).round(6)
    array([ 0.1, -1.5])
    """
    return ProximityQuery(mesh).signed_distance(points)


def read_points(points: ArrayLike, name: str = "points") -> NDArray[np.float64]:
    """Return (n, 3) float64, C-contiguous, or raise `QueryError`; the name in the message is trimesh's."""
    array = np.ascontiguousarray(np.asarray(points, dtype=np.float64))
    if array.ndim != 2 or array.shape[1] != 3:
        raise QueryError(f"{name} must be (n,3), not of shape {array.shape}")
    return array


def _closest_point(mesh: Any, options: EngineOptions, points: ArrayLike) -> ClosestPoints:
    vectors = read_points(points)

    def find(tracer: Tracer, tree: FollowedTree) -> ClosestPoints:
        closest = tracer.closest_point(vectors)
        choose_facing(vectors, tree.mesh, tree.vertex_faces, tol.merge, closest)
        return closest

    found: ClosestPoints = _kept_tracer(mesh, options).ask(mesh, find)
    return found


def _signed_distance(mesh: Any, options: EngineOptions, points: ArrayLike) -> NDArray[np.float64]:
    vectors = read_points(points)
    closest = _closest_point(mesh, options, vectors)
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
    distance[away[is_over]] *= -np.sign(height[is_over])

    # The others are nearest to an edge or a vertex.
    beside = away[~is_over]
    if len(beside):
        device, layout = options
        engine = RayMeshIntersector(mesh, device=device, layout=layout)
        distance[beside] *= np.where(engine.contains_points(vectors[beside]), 1.0, -1.0)
    return distance


def _kept_tracer(mesh: Any, options: EngineOptions) -> MeshTracer:
    return find_tracer(mesh, options, keep=True)


def _nearest_of_few(vertices: NDArray[Any], points: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the nearest vertices of a mesh that has no faces, and so no tree."""
    if len(vertices) == 0:
        raise QueryError("a mesh without vertices has no nearest one: give the mesh vertices first")
    distance, vertex_id = np.empty(len(points)), np.empty(len(points), np.int64)
    for index, point in enumerate(points):
        lengths = np.linalg.norm(vertices - point, axis=1)
        vertex_id[index] = lengths.argmin()
        distance[index] = lengths[vertex_id[index]]
    return distance, vertex_id


# Squared distances are equal when they differ by less than this share: a thousand roundings of float64.
_ROUNDING = 2.0**-42

# Largest tolerance of squared distances, as a share of them: next to the surface, the tolerance that trimesh adds to
# squares would return points that are not the closest.
_LARGEST_SHARE = 2.0**-20

# Cosines are equal when they differ by less than this: those of coplanar faces differ by roundings.
_SAME_COSINE = 2.0**-42

# Farther away than this many times half the mesh's size, the faces around differ by less than rounding, and a point
# keeps its face; and the vertices do, so the nearest one is found from that distance.
_FAR_SHARE = 2.0**20


def choose_facing(
    points: NDArray[np.float64], mesh: Mesh, around: VertexFaces, tolerance: float, closest: ClosestPoints
) -> None:
    """Replace each face by the one that faces the point most directly, among equally near ones around it.

    Parameters
    ----------
    points : (n, 3) float64, contiguous, the file's coordinates
    mesh : Mesh
    around : VertexFaces
        Of the mesh.
    tolerance : float, the file's unit squared
        Squared distances that differ by less are equal; points as near as this to the surface keep their faces.
    closest : ClosestPoints of the points, contiguous, written
        With the point and the distance of the face that is chosen.

    Notes
    -----
    Candidates are the faces that share a vertex with the face that was found. A nearer one replaces it, too, because
    the device chooses in float32. Of equally direct ones, the smallest number wins.
    """

    def choose(begin: int, end: int) -> None:
        distance, point, prim_id = closest
        part = ClosestPoints(distance[begin:end], point[begin:end], prim_id[begin:end])
        _choose(points[begin:end], triangles_of(mesh), mesh.origin, around, tolerance, part)

    with HostThreads() as threads:
        threads.for_ranges(len(points), choose)


@compiled(error_model="numpy")
def _choose(points, triangles, centre, around, tolerance, closest):
    scale = triangles.scale
    a, b, c, weights = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for index in range(len(points)):
        own, point = closest.prim_id[index], points[index]
        is_far = False
        for axis in range(3):
            is_far |= not abs((point[axis] - centre[axis]) * scale) < _FAR_SHARE
        if own == NO_PRIM or is_far:
            continue
        least = _see(point, triangles, own, a, b, c, weights)
        if least <= tolerance * scale * scale:
            continue
        equal = max(min(tolerance * scale * scale, least * _LARGEST_SHARE), least * _ROUNDING)
        best, facing = own, _facing(a, b, c, weights, least)
        for corner in range(3):
            point_id = around.point_ids[triangles.faces[own, corner]]
            for slot in range(around.begin[point_id], around.begin[point_id + 1]):
                face = around.faces[slot]
                if face == own:
                    continue
                squared = _see(point, triangles, face, a, b, c, weights)
                if not squared < least + equal:
                    continue
                other = _facing(a, b, c, weights, squared)
                is_nearer = squared <= least - equal
                is_equal = abs(other - facing) <= _SAME_COSINE and face < best
                if is_nearer or is_equal or other > facing + _SAME_COSINE:
                    best, facing, least = face, other, min(least, squared)
        if best == own:
            continue
        squared = _see(point, triangles, best, a, b, c, weights)
        closest.prim_id[index], closest.distance[index] = best, np.sqrt(squared) / scale
        first, second, third = triangles.faces[best, 0], triangles.faces[best, 1], triangles.faces[best, 2]
        for axis in range(3):
            origin = triangles.vertices[first, axis]
            to_second, to_third = triangles.vertices[second, axis] - origin, triangles.vertices[third, axis] - origin
            closest.point[index, axis] = origin + (weights[1] * to_second + weights[2] * to_third)


@compiled(error_model="numpy")
def _see(point, triangles, face, a, b, c, weights):
    """Write the corners as seen from a point, and the closest point's weights; return its squared distance, scaled."""
    for axis in range(3):
        a[axis] = (triangles.vertices[triangles.faces[face, 0], axis] - point[axis]) * triangles.scale
        b[axis] = (triangles.vertices[triangles.faces[face, 1], axis] - point[axis]) * triangles.scale
        c[axis] = (triangles.vertices[triangles.faces[face, 2], axis] - point[axis]) * triangles.scale
    return closest_on_triangle(a, b, c, weights)


@compiled(error_model="numpy")
def _facing(a, b, c, weights, squared):
    """Return the cosine between the normal and the way to the point; -2 for a triangle without a normal."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return -2.0
    along = 0.0
    for axis, component in enumerate((nx, ny, nz)):
        along -= component * (weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis])
    return along / (length * np.sqrt(squared))


# Boxes hold the vertices as float32 has them: a vertex of the file is this far outside at most, in local units, where
# no coordinate is above 1.
_BOX_SLACK = 2.0**-23


def find_nearest_vertices(bvh: Bvh, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance to the nearest vertex of a tree's mesh, and its index, for each point.

    Parameters
    ----------
    bvh : Bvh
    points : (n, 3) float64, the file's coordinates
        Finite.

    Returns
    -------
    distance : (n,) float64, the file's unit
    vertex_id : (n,) int64
        At equal distance the smallest. Vertices without a face count, too; each of them is compared.
    """
    mesh, nodes = bvh.mesh, bvh.nodes
    points = np.ascontiguousarray(points, np.float64)
    loose = mesh.loose_vertices
    tree = nodes.view(np.float32).reshape(-1, NODE_LANES), nodes["first"], nodes["count"], bvh.prim_ids
    vertex_id = np.empty(len(points), np.int64)

    def find(begin: int, end: int) -> None:
        _find(points[begin:end], mesh.origin, triangles_of(mesh), tree, bvh.depth, loose, vertex_id[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(points), find)
    return _lengths(mesh.vertices[vertex_id] - points), vertex_id


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors, whose squares may overflow or underflow float64."""
    exponents = np.frexp(np.abs(vectors).max(axis=1, initial=0.0))[1]
    return np.ldexp(np.linalg.norm(np.ldexp(vectors, -exponents[:, None]), axis=1), exponents)


@compiled(error_model="numpy")
def _find(points, centre, triangles, tree, depth, loose, vertex_id):
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    boxes, first, count, prim_ids = tree
    local = np.empty(3)
    # A descent leaves one sibling behind at each level.
    stack, stack_near = np.empty(depth + 2, np.int64), np.empty(depth + 2)
    for index in range(len(points)):
        size = 0.0
        for axis in range(3):
            local[axis] = (points[index, axis] - centre[axis]) * scale
            size = max(size, abs(local[axis]))
        share = _FAR_SHARE / size if size > _FAR_SHARE else 1.0
        for axis in range(3):
            local[axis] *= share
        # Boxes farther away than this hold no nearer vertex.
        best, nearest, limit = np.inf, -1, np.inf
        for vertex in loose:
            best, nearest = _nearer(vertices, vertex, centre, scale, local, best, nearest)
        limit = np.sqrt(best) + _BOX_SLACK
        stack[0], stack_near[0], height = 0, 0.0, 1
        while height > 0:
            height -= 1
            node = stack[height]
            if stack_near[height] > limit:
                continue
            if count[node] > 0:
                for slot in range(first[node], first[node] + count[node]):
                    for corner in range(3):
                        vertex = faces[prim_ids[slot], corner]
                        best, nearest = _nearer(vertices, vertex, centre, scale, local, best, nearest)
                limit = np.sqrt(best) + _BOX_SLACK
                continue
            left, right = first[node], first[node] + 1
            left_near, right_near = _box_distance(boxes, left, local), _box_distance(boxes, right, local)
            if left_near < right_near:
                left, right, left_near, right_near = right, left, right_near, left_near
            # The nearer one is on top.
            stack[height], stack_near[height] = left, left_near
            stack[height + 1], stack_near[height + 1] = right, right_near
            height += 2
        vertex_id[index] = nearest


@compiled(error_model="numpy")
def _nearer(vertices, vertex, centre, scale, local, best, nearest):
    """Return the smaller squared distance, and its vertex."""
    squared = 0.0
    for axis in range(3):
        away = (vertices[vertex, axis] - centre[axis]) * scale - local[axis]
        squared += away * away
    if squared < best or (squared == best and vertex < nearest):
        return squared, vertex
    return best, nearest


@compiled(error_model="numpy")
def _box_distance(boxes, node, local):
    """Return the distance from a point to a node's box."""
    squared = 0.0
    for axis in range(3):
        lower, upper = np.float64(boxes[node, axis]), np.float64(boxes[node, NODE_MAX + axis])
        away = max(lower - local[axis], local[axis] - upper, 0.0)
        squared += away * away
    return np.sqrt(squared)

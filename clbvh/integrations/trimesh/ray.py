"""The ray engines of a mesh and of a scene of trimesh: assign a mesh's to ``mesh.ray``, and all ray queries use it.

Names, arguments, defaults, orders and dtypes are those of trimesh 5's ``ray_pyembree.RayMeshIntersector``. Where that
one returns triangles, the engine of a scene also returns nodes.
"""

from __future__ import annotations

from copy import copy
from functools import partial
from typing import Any, Self

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from ...device.info import DeviceInfo
from ...errors import MeshError, QueryError, SceneError
from ...trace.hits.hits import AllHits
from ...trace.points.winding import WINDING, check_rule
from .tracers import find_tracer, read_mesh, read_options

# Directions along which crossings are counted, in this order of preference. Any will do: a direction that no mesh is
# modelled along meets few edges exactly, where the traversal has the most to do.
_GENERIC_DIRECTIONS = np.array([[0.374, 0.621, 0.689], [-0.571, 0.277, 0.773]])

# Points whose rays are cast at a time; the crossings of a scene's are on the host.
_POINTS_AT_ONCE = 2**18


class RayEngine:
    """The ray queries of a mesh or a scene of trimesh, which a tracer follows.

    Any number of threads may use one object, as long as none changes the mesh or the scene meanwhile.

    Attributes
    ----------
    options : EngineOptions
        The device and the layout that were asked for.
    """

    def __init__(self, thing: Any, device: DeviceInfo | str | int | None, layout: str, rule: str) -> None:
        check_rule(rule)
        self._thing, self.options, self._rule = thing, read_options(device, layout), rule
        self._is_scene = isinstance(thing, trimesh.Scene)
        self._tracer = find_tracer(thing, self.options, keep=False)

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True
    ) -> tuple[NDArray[Any], ...]:
        """Return where rays hit the mesh or the scene.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length; of a scene in its base frame.
        multiple_hits : bool
            All hits of each ray, up to 100, or only the first one.

        Returns
        -------
        locations : (m, 3) float64
        index_ray : (m,) int64
        index_tri : (m,) int64
            All rays' first hits in the order of the rays, then all second hits, and so on.
        index_node : (m,) int64
            Only of a scene; `index_tri` are faces of the geometry that was hit.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector, SceneRay
        >>> engine = RayMeshIntersector(trimesh.creation.box())
        >>> locations, index_ray, index_tri = engine.intersects_location([[0.1, 0.2, 5]], [[0, 0, -1]])
        >>> locations
        array([[ 0.1,  0.2,  0.5],
               [ 0.1,  0.2, -0.5]])
        >>> index_ray
        array([0, 0])
        >>> engine = SceneRay(trimesh.Scene(trimesh.creation.box()))
        >>> locations, index_ray, index_tri, index_node = engine.intersects_location([[0.1, 0.2, 5]], [[0, 0, -1]])
        >>> locations
        array([[ 0.1,  0.2,  0.5],
               [ 0.1,  0.2, -0.5]])
        """
        index_tri, index_ray, *index_node, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits, return_locations=True
        )
        return locations, index_ray, index_tri, *index_node

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int = 100,
        return_locations: bool = False,
    ) -> tuple[NDArray[Any], ...]:
        """Return which triangles rays hit, and of which nodes.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length; of a scene in its base frame.
        multiple_hits : bool
            All hits of each ray, or only the first one.
        max_hits : int
            Hits of each ray at most.
        return_locations : bool

        Returns
        -------
        index_tri : (m,) int64
        index_ray : (m,) int64
            All rays' first hits in the order of the rays, then all second hits, and so on.
        index_node : (m,) int64
            Only of a scene; `index_tri` are faces of the geometry that was hit.
        locations : (m, 3) float64
            Only with `return_locations`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector, SceneRay
        >>> engine = RayMeshIntersector(trimesh.creation.box())
        >>> index_tri, index_ray = engine.intersects_id([[0.1, 0.2, 5], [3, 0, 5]], [[0, 0, -1]] * 2)
        >>> index_ray
        array([0, 0])
        >>> ray = SceneRay(trimesh.Scene([trimesh.creation.box(), trimesh.creation.icosphere(radius=2)]))
        >>> index_tri, index_ray, index_node = ray.intersects_id([[0.1, 0.2, 5]], [[0, 0, -1]])
        >>> index_node
        array([1, 0, 0, 1])
        """
        rays = read_rays(ray_origins, ray_directions)
        if max_hits < 1:
            rays, max_hits = (rays[0][:0], rays[1][:0]), 1
        if not (multiple_hits or return_locations or self._is_scene):
            first = self._cast("closest_prim", rays)
            index_ray = np.flatnonzero(first >= 0)
            return first[index_ray].astype(np.int64), index_ray
        if multiple_hits:
            hits = self._cast("all_hits", rays, max_hits=int(max_hits), with_locations=return_locations)
            order, index_ray = order_by_depth(hits)
        else:
            hits = self._cast("closest_hit", rays)
            order = index_ray = np.flatnonzero(hits.is_hit)
        found = [hits.prim_id[order].astype(np.int64), index_ray]
        if self._is_scene:
            found.append(hits.instance_id[order].astype(np.int64))
        if return_locations:
            found.append(hits.locations[order])
        return tuple(found)

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) bool: whether each ray hits anything.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector
        >>> RayMeshIntersector(trimesh.creation.box()).intersects_any([[0, 0, 5], [3, 0, 5]], [[0, 0, -1]] * 2)
        array([ True, False])
        """
        return self._cast("any_hit", read_rays(ray_origins, ray_directions))

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) bool: whether the mesh, or any mesh of the scene, contains points; on a surface it is either.

        Parameters
        ----------
        points : (n, 3) float
            Of a scene in its base frame.

        Notes
        -----
        A point is inside when rays from it in two opposite directions leave the mesh an odd number of times; faces that
        coincide count as in `Tracer.contains`. In a closed mesh the two always agree. Where they do not, a point from
        which one of them meets nothing is outside, and the others get another pair of rays. In a scene each node is
        asked on its own, so a point in two meshes that overlap is inside.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector, SceneRay
        >>> RayMeshIntersector(trimesh.creation.box()).contains_points([[0, 0, 0], [1, 1, 1]])
        array([ True, False])
        >>> ray = SceneRay(trimesh.Scene([trimesh.creation.box(), trimesh.creation.icosphere(radius=2)]))
        >>> ray.contains_points([[0, 0, 0], [0, 1, 1], [3, 0, 0]])
        array([ True,  True, False])
        """
        points = read_points(points)
        if self._rule == WINDING:
            return np.asarray(self._tracer.ask(self._thing, lambda tracer, _: tracer.contains(points, rule=self._rule)))
        contains = np.zeros(len(points), np.bool_)
        if self._is_scene:
            is_candidate = np.isfinite(points)
        elif self._thing.bounds is None:
            raise MeshError("a mesh without faces contains no points: give the mesh faces first")
        else:
            is_candidate = (points > self._thing.bounds[0]) & (points < self._thing.bounds[1])
        candidates = np.flatnonzero(is_candidate.all(axis=1))
        for begin in range(0, len(candidates), _POINTS_AT_ONCE):
            undecided, pending = candidates[begin : begin + _POINTS_AT_ONCE], None
            for direction in _GENERIC_DIRECTIONS:
                pairs, ahead, behind = self._count_hits(points, undecided, direction)
                if pending is not None:
                    is_pending = np.isin(pairs, pending, assume_unique=True)
                    pairs, ahead, behind = pairs[is_pending], ahead[is_pending], behind[is_pending]
                contains[pairs[(ahead & behind & 1) == 1] >> 32] = True
                # A node that one of the rays does not meet is left by the other.
                pending = pairs[((ahead ^ behind) & 1 == 1) & (ahead > 0) & (behind > 0)]
                pending = pending[~contains[pending >> 32]]
                if len(pending) == 0:
                    break
                undecided = np.unique(pending >> 32)
        return contains

    def _count_hits(
        self, points: NDArray[np.float64], chosen: NDArray[np.int64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.integer], NDArray[np.integer]]:
        """Return pairs ``point << 32 | node`` for chosen points, and how often rays there and back meet the node."""
        surplus = self._tracer.ask(self._thing, lambda tracer, _: tracer._caster.world.surplus)
        query = "count_hits" if not self._is_scene and surplus is None else "all_hits"
        there, back = (self._cast(query, (points[chosen], way[None])) for way in (direction, -direction))
        if query == "count_hits":
            return chosen << 32, there, back
        met = []
        for hits in (there, back):
            found = (chosen[hits.ray_id] << 32) | hits.instance_id
            met.append(found if surplus is None else found[~surplus.holds(hits.prim_id, hits.instance_id)])
        pairs, index = np.unique(np.concatenate(met), return_inverse=True)
        ahead, behind = (np.bincount(each, minlength=len(pairs)) for each in np.split(index, [len(met[0])]))
        return pairs, ahead, behind

    def _cast(self, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a query of the tracer; rays that it refuses hit nothing."""
        return self._tracer.cast(self._thing, query, rays, **more)

    def close(self) -> None:
        """Give the device's memory back, after the queries of other threads; the next query takes it again."""
        self._tracer.close()

    def __repr__(self) -> str:
        tracer = self._tracer.open_tracer
        device, layout = self.options if tracer is None else (tracer.device.name, tracer.layout)
        return f"clbvh.{type(self).__name__}({self._thing!r}, device={device!r}, layout={layout!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self.options._asdict()), (self._thing,)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # The same mesh, as trimesh's engine has it: a copy of a mesh makes an engine of its own.
        return copy(self)


class RayMeshIntersector(RayEngine):
    """Ray queries of a mesh on an OpenCL device.

    Parameters
    ----------
    geometry : trimesh.Trimesh, or Mesh, str, path or (vertices, faces)
        A `trimesh.Trimesh` may change later: the tree is built when first needed, refitted when only vertices have
        moved, and built again when faces have changed. Of anything else that is a mesh, `mesh` is a new
        `trimesh.Trimesh` with the same vertices and faces, in their order.
    scale_to_box : bool
        Taken for trimesh's sake. Any scale is exact as it is.
    device : DeviceInfo, str, int or None
        See `clbvh.Tracer`.
    layout : str
        See `clbvh.Tracer`.
    rule : str
        By which points are inside: ``"winding"`` needs no closed mesh, see `clbvh.Tracer.contains`.

    Notes
    -----
    One hit per point of the surface, however many triangles meet there; of faces that coincide, one of each. Hits are
    found by one traversal, never by casting again from where the last one was. Rays without direction, or that are not
    finite, hit nothing.

    Any number of threads may use one object, as long as none changes the mesh meanwhile. All engines of one mesh with
    the same options share one tree; the device's memory goes back with the last engine, or by `close`.

    Raises
    ------
    MeshError
        The geometry is not a mesh.
    ConfigError
        An unknown layout, or a device of another type.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import RayMeshIntersector
    >>> mesh = trimesh.creation.box()
    >>> mesh.ray = RayMeshIntersector(mesh)
    >>> mesh.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])
    array([ True])
    """

    def __init__(
        self,
        geometry: Any,
        scale_to_box: bool = True,
        *,
        device: DeviceInfo | str | int | None = None,
        layout: str = "auto",
        rule: str = "parity",
    ) -> None:
        super().__init__(read_mesh(geometry), device, layout, rule)

    @property
    def mesh(self) -> Any:
        """The `trimesh.Trimesh`."""
        return self._thing

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.int32]:
        """Return (n,) int32: the first triangle that each ray hits, -1 if there is none.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector
        >>> mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> RayMeshIntersector(mesh).intersects_first([[0.2, 0.2, 1], [0.9, 0.9, 1]], [[0, 0, -1]] * 2)
        array([ 0, -1], dtype=int32)
        """
        return self._cast("closest_prim", read_rays(ray_origins, ray_directions))


class SceneRay(RayEngine):
    """Ray queries of all triangle meshes of a scene, where its nodes place them, on an OpenCL device.

    Parameters
    ----------
    scene : trimesh.Scene
        It may change later. When nodes have moved, only the tree over the nodes is built anew; when only vertices of a
        mesh have moved, its tree is refitted; after other changes the next query builds all trees. Changes are found by
        trimesh's own hashes. Paths, point clouds and nodes that a scale of 0 hides are left out.
    device : DeviceInfo, str, int or None
        See `clbvh.Tracer`.
    layout : str
        See `clbvh.Tracer`.

    Raises
    ------
    SceneError
        The argument is no scene. By the first query: a node's transform is not finite, or there is no mesh.
    ConfigError
        An unknown layout, or a device of another type.

    Notes
    -----
    A hit is named by `index_tri`, the face in ``scene.geometry[name]``, and `index_node`, which indexes `nodes` and
    `geometries`. One hit per surface crossing of each node. Rays without direction, or that are not finite, hit
    nothing. Any number of threads may use one object, as long as none changes the scene meanwhile.

    All engines of one scene with the same options share its trees; the device's memory goes back with the last engine,
    or by `close`.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import SceneRay
    >>> scene = trimesh.Scene()
    >>> box = trimesh.creation.box()
    >>> _ = scene.add_geometry(box, node_name="left", geom_name="crate")
    >>> _ = scene.graph.update("right", geometry="crate", matrix=trimesh.transformations.translation_matrix([3, 0, 0]))
    >>> ray = SceneRay(scene)
    >>> down = [[3, 0.1, 5], [0.1, 0, 5]], [[0, 0, -1], [0, 0, -1]]
    >>> locations, index_ray, index_tri, index_node = ray.intersects_location(*down)
    >>> locations[:2]
    array([[3. , 0.1, 0.5],
           [0.1, 0. , 0.5]])
    >>> ray.nodes[index_node], ray.geometries[index_node]
    (array(['right', 'left', 'right', 'left'], dtype=object), array(['crate', 'crate', 'crate', 'crate'], dtype=object))

    The scene moves:

    >>> _ = scene.graph.update("right", matrix=trimesh.transformations.translation_matrix([0, 0, 3]))
    >>> index_tri, index_node = ray.intersects_first(*down)
    >>> index_node
    array([-1,  1], dtype=int32)
    """

    def __init__(
        self,
        scene: Any,
        *,
        device: DeviceInfo | str | int | None = None,
        layout: str = "auto",
        rule: str = "parity",
    ) -> None:
        if not isinstance(scene, trimesh.Scene):
            raise SceneError(
                f"expected a trimesh.Scene, not {type(scene).__name__}: for one mesh, use RayMeshIntersector"
            )
        super().__init__(scene, device, layout, rule)

    @property
    def scene(self) -> Any:
        """The `trimesh.Scene`."""
        return self._thing

    @property
    def nodes(self) -> NDArray[np.object_]:
        """(n,) object: the names of the nodes that show a triangle mesh, by `index_node`, as the scene is now."""
        nodes = self._tracer.nodes(self.scene)
        return np.fromiter((node for node, _ in nodes), object, len(nodes))

    @property
    def geometries(self) -> NDArray[np.object_]:
        """(n,) object: the name of each node's geometry, a key of ``scene.geometry``, as the scene is now."""
        nodes = self._tracer.nodes(self.scene)
        return np.fromiter((geometry for _, geometry in nodes), object, len(nodes))

    def intersects_first(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the first triangle that each ray hits, and its node.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            In the scene's base frame; directions of any length.

        Returns
        -------
        index_tri, index_node : (n,) int32
            Of each ray, -1 if it hits nothing.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import SceneRay
        >>> scene = trimesh.Scene({"tri": trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])})
        >>> SceneRay(scene).intersects_first([[0.2, 0.2, 1], [0.9, 0.9, 1]], [[0, 0, -1]] * 2)
        (array([ 0, -1], dtype=int32), array([ 0, -1], dtype=int32))
        """
        hits = self._cast("closest_hit", read_rays(ray_origins, ray_directions))
        return hits.prim_id, hits.instance_id


def order_by_depth(hits: AllHits) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the order of all rays' first hits, then all second hits, and so on; and the ray of each in that order."""
    ray_id = hits.ray_id
    depth = np.arange(len(ray_id)) - hits.offsets[ray_id]
    # Stable, and in linear time where numpy sorts short integers by their digits.
    order = np.argsort(depth.astype(np.min_scalar_type(int(depth.max(initial=0)))), kind="stable")
    return order, ray_id[order]


def read_rays(origins: ArrayLike, directions: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both as arrays of one shape."""
    rays = np.asarray(origins), np.asarray(directions)
    if rays[0].shape != rays[1].shape:
        raise QueryError("Ray origin and direction don't match!")
    if rays[0].ndim == 1 and rays[0].size:
        raise QueryError(f"ray_origins and ray_directions must be (n,3), not of shape {rays[0].shape}")
    return rays


def read_points(points: ArrayLike, name: str = "points") -> NDArray[np.float64]:
    """Return (n, 3) float64, C-contiguous, or raise `QueryError`; the name in the message is trimesh's."""
    array = np.ascontiguousarray(np.asarray(points, dtype=np.float64))
    if array.ndim != 2 or array.shape[1] != 3:
        raise QueryError(f"{name} must be (n,3), not of shape {array.shape}")
    return array

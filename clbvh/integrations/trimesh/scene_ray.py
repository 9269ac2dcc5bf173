"""The ray engine of a whole `trimesh.Scene`: the queries of trimesh's ray engines, and the node that was hit.

Names, arguments, defaults and orders are those of `RayMeshIntersector`; where it returns triangles, this one also
returns nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.info import DeviceInfo
from ...errors import SceneError
from ...trace.points.queries import GENERIC_DIRECTIONS
from .ray import MAX_HITS, RayEngine, read_points, read_rays
from .scene_tracer import SceneTracer

# Points whose rays are cast at a time; their crossings are on the host.
_POINTS_AT_ONCE = 2**18


class SceneRay(RayEngine):
    """Ray queries of all triangle meshes of a scene, where its nodes place them, on an OpenCL device.

    Parameters
    ----------
    scene : trimesh.Scene
        It may change later. When nodes have moved, only the tree over the nodes is built anew; when only vertices of a
        mesh have moved, its tree is refitted; after other changes the next query builds all trees. Changes are found by
        trimesh's own hashes. Paths and point clouds are left out.
    device : DeviceInfo, str, int or None
        See `clbvh.Tracer`.
    layout : str
        See `clbvh.Tracer`.

    Raises
    ------
    SceneError
        The argument is no scene. By the first query: a node has a singular transform, or there is no mesh.
    ConfigError
        An unknown layout, or a device of another type.

    Notes
    -----
    A hit is named by `index_tri`, the face in ``scene.geometry[name]``, and `index_node`, which indexes `nodes` and
    `geometries`. One hit per surface crossing of each node. Rays without direction, or that are not finite, hit
    nothing. Any number of threads may use one object, as long as none changes the scene meanwhile.

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

    _tracer: SceneTracer

    def __init__(self, scene: Any, *, device: DeviceInfo | str | int | None = None, layout: str = "auto") -> None:
        import trimesh

        if not isinstance(scene, trimesh.Scene):
            raise SceneError(
                f"expected a trimesh.Scene, not {type(scene).__name__}: for one mesh, use RayMeshIntersector"
            )
        super().__init__(scene, device, layout)

    @property
    def scene(self) -> Any:
        """The `trimesh.Scene`."""
        return self._thing

    @property
    def nodes(self) -> NDArray[np.object_]:
        """(n,) object: the names of the nodes that place a triangle mesh, by `index_node`, as the scene is now."""
        nodes = self._tracer.nodes(self.scene)
        return np.fromiter((node for node, _ in nodes), object, len(nodes))

    @property
    def geometries(self) -> NDArray[np.object_]:
        """(n,) object: the name of each node's geometry, a key of ``scene.geometry``, as the scene is now."""
        nodes = self._tracer.nodes(self.scene)
        return np.fromiter((geometry for _, geometry in nodes), object, len(nodes))

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return where rays hit the scene.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            In the scene's base frame; directions of any length.
        multiple_hits : bool
            All hits of each ray, up to 100, or only the first one.

        Returns
        -------
        locations : (m, 3) float64
        index_ray : (m,) int64
        index_tri : (m,) int64
            Faces of the geometry that was hit.
        index_node : (m,) int64
            All rays' first hits in the order of the rays, then all second hits, and so on.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import SceneRay
        >>> ray = SceneRay(trimesh.Scene(trimesh.creation.box()))
        >>> ray.intersects_location([[0.1, 0.2, 5]], [[0, 0, -1]])[0]
        array([[ 0.1,  0.2,  0.5],
               [ 0.1,  0.2, -0.5]])
        """
        index_tri, index_ray, index_node, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, return_locations=True
        )
        return locations, index_ray, index_tri, index_node

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int = MAX_HITS,
        return_locations: bool = False,
    ) -> tuple[NDArray[Any], ...]:
        """Return which triangles of which nodes rays hit.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            In the scene's base frame; directions of any length.
        multiple_hits : bool
            All hits of each ray, or only the first one.
        max_hits : int
            Hits of each ray at most.
        return_locations : bool

        Returns
        -------
        index_tri : (m,) int64
            Faces of the geometry that was hit.
        index_ray : (m,) int64
            All rays' first hits in the order of the rays, then all second hits, and so on.
        index_node : (m,) int64
        locations : (m, 3) float64
            Only with `return_locations`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import SceneRay
        >>> ray = SceneRay(trimesh.Scene([trimesh.creation.box(), trimesh.creation.icosphere(radius=2)]))
        >>> index_tri, index_ray, index_node = ray.intersects_id([[0.1, 0.2, 5]], [[0, 0, -1]])
        >>> index_node
        array([1, 0, 0, 1])
        """
        found = self._find_hits(ray_origins, ray_directions, multiple_hits, max_hits, return_locations)
        return found if return_locations else found[:3]

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

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) bool: whether any mesh of the scene contains points; on a surface the answer is either.

        Parameters
        ----------
        points : (n, 3) float
            In the scene's base frame.

        Notes
        -----
        Each node is asked on its own, so a point in two meshes that overlap is inside. It is inside one when rays from
        it in two opposite directions leave that mesh an odd number of times, as `RayMeshIntersector.contains_points`
        has it.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import SceneRay
        >>> ray = SceneRay(trimesh.Scene([trimesh.creation.box(), trimesh.creation.icosphere(radius=2)]))
        >>> ray.contains_points([[0, 0, 0], [0, 1, 1], [3, 0, 0]])
        array([ True,  True, False])
        """
        points = read_points(points)
        contains = np.zeros(len(points), np.bool_)
        for begin in range(0, max(1, len(points)), _POINTS_AT_ONCE):
            part = slice(begin, begin + _POINTS_AT_ONCE)
            contains[part] = self._contains(points[part])
        return contains

    def _contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether points are inside; see `contains_points`."""
        contains = np.zeros(len(points), np.bool_)
        undecided, pending = np.arange(len(points)), None
        for direction in GENERIC_DIRECTIONS:
            (there, one_way), (back, other_way) = (
                self._count_crossings(points, undecided, sign * direction) for sign in (1, -1)
            )
            # Pairs of a point and a node that both rays meet; a node that one ray does not meet is left by the other.
            pairs, first, second = np.intersect1d(there, back, assume_unique=True, return_indices=True)
            ahead, behind = one_way[first], other_way[second]
            if pending is not None:
                is_pending = np.isin(pairs, pending, assume_unique=True)
                pairs, ahead, behind = pairs[is_pending], ahead[is_pending], behind[is_pending]
            is_inside = (ahead % 2 == 1) & (behind % 2 == 1)
            contains[pairs[is_inside] >> 32] = True
            pending = pairs[ahead % 2 != behind % 2]
            undecided = np.unique(pending >> 32)
            undecided = undecided[~contains[undecided]]
            if len(undecided) == 0:
                break
        return contains

    def _count_crossings(
        self, points: NDArray[np.float64], chosen: NDArray[np.int64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return ``point << 32 | node`` of each node that a point's ray meets, ascending, and how often it does."""
        hits = self._cast("all_hits", (points[chosen], np.tile(direction, (len(chosen), 1))))
        return np.unique((chosen[hits.ray_id] << 32) | hits.instance_id, return_counts=True)

    def _find_tracer(self) -> SceneTracer:
        return SceneTracer(self._options)

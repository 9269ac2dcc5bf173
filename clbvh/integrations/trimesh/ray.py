"""The ray engine of a `trimesh.Trimesh`: assign it to ``mesh.ray``, and all ray queries of trimesh use it.

Names, arguments, defaults, orders and dtypes are those of trimesh 5's ``ray_pyembree.RayMeshIntersector``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.info import DeviceInfo
from ...errors import MeshError, QueryError
from ...trace.hits.hits import AllHits
from ...trace.points.queries import GENERIC_DIRECTIONS
from .following_tracer import EngineOptions, FollowingTracer, read_options
from .tracers import MeshTracer, find_tracer, read_mesh

# Most hits of a ray, unless the caller says otherwise: trimesh's default.
MAX_HITS = 100


class RayEngine(ABC):
    """What the ray engines of a mesh and of a scene share: a tracer that follows it, and copies.

    Any number of threads may use one object, as long as none changes the mesh or the scene meanwhile.
    """

    def __init__(self, thing: Any, device: DeviceInfo | str | int | None, layout: str) -> None:
        self._thing = thing
        self._options = read_options(device, layout)
        self._tracer = self._find_tracer()

    @abstractmethod
    def _find_tracer(self) -> FollowingTracer[Any]:
        """Return the tracer of the engine."""

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

    @property
    def options(self) -> EngineOptions:
        """The device and the layout that were asked for."""
        return self._options

    def close(self) -> None:
        """Give the device's memory back, after the queries of other threads; the next query takes it again."""
        self._tracer.close()

    def _find_hits(
        self, origins: ArrayLike, directions: ArrayLike, multiple_hits: bool, max_hits: int, with_locations: bool
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return triangles, rays, nodes and locations: all first hits in the order of the rays, all second hits, ..."""
        rays = read_rays(origins, directions)
        if max_hits < 1:
            rays, max_hits = (rays[0][:0], rays[1][:0]), 1
        if multiple_hits:
            hits = self._cast("all_hits", rays, max_hits=int(max_hits), with_locations=with_locations)
            order, index_ray = order_by_depth(hits)
        else:
            hits = self._cast("closest_hit", rays)
            order = index_ray = np.flatnonzero(hits.is_hit)
        locations = hits.locations[order] if with_locations else np.empty((0, 3))
        return hits.prim_id[order].astype(np.int64), index_ray, hits.instance_id[order].astype(np.int64), locations

    def _cast(self, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a query of the tracer; rays that it refuses hit nothing."""
        return self._tracer.cast(self._thing, query, rays, **more)

    def __repr__(self) -> str:
        tracer = self._tracer.open_tracer
        device, layout = self._options if tracer is None else (tracer.device.name, tracer.layout)
        return f"clbvh.{type(self).__name__}({self._thing!r}, device={device!r}, layout={layout!r})"

    def __getstate__(self) -> dict[str, Any]:
        return {"_thing": self._thing, "_options": self._options}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._tracer = self._find_tracer()

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

    Notes
    -----
    One hit per surface crossing, whatever the triangles that meet there; hits are found by one traversal, never by
    casting again from where the last one was. Rays without direction, or that are not finite, hit nothing.

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
    ) -> None:
        super().__init__(read_mesh(geometry), device, layout)

    @property
    def mesh(self) -> Any:
        """The `trimesh.Trimesh`."""
        return self._thing

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Return where rays hit the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length.
        multiple_hits : bool
            All hits of each ray, up to 100, or only the first one.

        Returns
        -------
        locations : (m, 3) float64
        index_ray : (m,) int64
        index_tri : (m,) int64
            All rays' first hits in the order of the rays, then all second hits, and so on.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector
        >>> engine = RayMeshIntersector(trimesh.creation.box())
        >>> locations, index_ray, index_tri = engine.intersects_location([[0.1, 0.2, 5]], [[0, 0, -1]])
        >>> locations
        array([[ 0.1,  0.2,  0.5],
               [ 0.1,  0.2, -0.5]])
        >>> index_ray
        array([0, 0])
        """
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int = MAX_HITS,
        return_locations: bool = False,
    ) -> tuple[NDArray[Any], ...]:
        """Return which triangles rays hit.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions of any length.
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
        locations : (m, 3) float64
            Only with `return_locations`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector
        >>> engine = RayMeshIntersector(trimesh.creation.box())
        >>> index_tri, index_ray = engine.intersects_id([[0.1, 0.2, 5], [3, 0, 5]], [[0, 0, -1]] * 2)
        >>> index_ray
        array([0, 0])
        """
        if not (multiple_hits or return_locations) and max_hits > 0:
            first = self.intersects_first(ray_origins, ray_directions)
            index_ray = np.flatnonzero(first >= 0)
            return first[index_ray].astype(np.int64), index_ray
        index_tri, index_ray, _, locations = self._find_hits(
            ray_origins, ray_directions, multiple_hits, max_hits, return_locations
        )
        return (index_tri, index_ray, locations) if return_locations else (index_tri, index_ray)

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

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return (n,) bool: whether the mesh contains points; on its surface the answer is either.

        Parameters
        ----------
        points : (n, 3) float

        Notes
        -----
        A point is inside when rays from it in two opposite directions leave the mesh an odd number of times. In a
        closed mesh they always agree. Where they do not, a point from which one of them meets nothing is outside, and
        the others get another pair of rays.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import RayMeshIntersector
        >>> RayMeshIntersector(trimesh.creation.box()).contains_points([[0, 0, 0], [1, 1, 1]])
        array([ True, False])
        """
        points = read_points(points)
        if self.mesh.bounds is None:
            raise MeshError("a mesh without faces contains no points: give the mesh faces first")
        contains = np.zeros(len(points), np.bool_)
        undecided = np.flatnonzero(((points > self.mesh.bounds[0]) & (points < self.mesh.bounds[1])).all(axis=1))
        for direction in GENERIC_DIRECTIONS:
            if len(undecided) == 0:
                break
            there, back = (
                self._cast("count_hits", (points[undecided], np.tile(sign * direction, (len(undecided), 1))))
                for sign in (1, -1)
            )
            agree = there % 2 == back % 2
            contains[undecided] = agree & (there % 2 == 1)
            undecided = undecided[~agree & (there > 0) & (back > 0)]
        return contains

    def _find_tracer(self) -> MeshTracer:
        return find_tracer(self.mesh, self._options, keep=False)


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

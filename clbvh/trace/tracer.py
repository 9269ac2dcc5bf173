"""The public class for ray and point queries: their arguments, results and errors.

The queries themselves are in `hits/` and `points/`.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterable
from functools import partial
from numbers import Integral
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.session import DeviceSession
from ..errors import ConfigError, OpenMeshWarning
from ..geometry import Mesh, MeshLike, as_mesh
from ..scene.contents import SceneContents
from ..scene.geometry import Geometry
from ..scene.instance import Instance
from ..support.context_manager import ContextManager
from .device_tree import DeviceTree, check_layout
from .hits.all_hits import find_all_hits, find_hits_by_depth
from .hits.closest import count_hits, find_any_hits, find_closest_hits, find_closest_prims
from .hits.hits import AllHits, Hits
from .launch import NO_LIMIT, Caster
from .points.ambient_occlusion import check_sampling, find_open_shares
from .points.hemispheres import Hemispheres
from .points.queries import SeenPoints, closest_points, is_contained, signed_distances
from .points.refine import ClosestPoints
from .rays.batch import RayBatch, TreeBox, read_rays
from .rays.pieces import Progress
from .scene.device_scene import DeviceScene
from .scene.moving_scene import MovingScene
from .tree_copies import TreeCopies

Traceable: TypeAlias = SceneContents | Bvh | MeshLike
"""Anything that rays can be cast at: a `Scene`, a `Bvh`, or a `MeshLike`."""


class Tracer(ContextManager):
    """Casts rays at one mesh on one device; a context manager.

    Any number of threads may use one tracer. A child that was forked cannot: its queries raise `DeviceError`, and
    closing the tracer there changes nothing.

    Parameters
    ----------
    source : Scene, Bvh, or Mesh, trimesh.Trimesh, str, path or (vertices, faces)
        A scene as it is now; a tree; or a mesh. Trees are built in this process, as `clbvh.build` does. A path names a
        mesh file.
    device : DeviceInfo, str, int or None
        The device: a number, part of its name, ``"gpu"`` or ``"cpu"``; by default a GPU, if there is one.
    layout : str
        ``"auto"``, ``"bvh2"``, ``"bvh4"`` or ``"bvh8"``.

    Raises
    ------
    DeviceError
        There is no such device, the tree does not fit it, or this process was forked from one that has used OpenCL.
    ConfigError
        An unknown layout.
    MeshError
        The source is neither a tree nor a valid mesh.

    Examples
    --------
    >>> import clbvh
    >>> triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    >>> with clbvh.Tracer(triangle) as tracer:
    ...     tracer.closest_hit([[0.25, 0.25, 2]], [[0, 0, -1]]).t
    array([2.])
    """

    def __init__(
        self,
        source: Traceable,
        *,
        device: DeviceInfo | str | int | None = None,
        layout: str = "auto",
    ) -> None:
        check_layout(layout)
        self._scene = _open_scene(source) if isinstance(source, SceneContents) else None
        bvh = None if isinstance(source, SceneContents) else _find_tree(source)
        self._has_warned = False
        self._updating = threading.Lock()
        session = DeviceSession(device)
        tree: DeviceTree | DeviceScene
        try:
            if self._scene is not None:
                tree, box = self._scene.open(session, layout)
            elif bvh is not None:
                tree, box = DeviceTree(session, bvh.mesh, bvh, layout), TreeBox.around(bvh)
        except BaseException:
            session.close()
            raise
        # Each query reads it once, because an update replaces it.
        self._caster = Caster(session, tree, box)
        self._copies = TreeCopies(self._caster) if self._scene is None else None

    def closest_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> Hits:
        """Return the nearest crossing of each ray with the mesh, from either side of the triangles.

        Parameters
        ----------
        origins : (..., 3) float, the file's coordinates
            Of any leading shape. Rays of shape (height, width, 3) are those of a picture, which are cast tile by tile.
        directions : (..., 3) float, any length above 0
            Broadcast against the origins, without copies: one origin (3,) for many directions (n, 3), or (n, 1, 3) with
            (m, 3) for all pairs.
        t_min, t_max : float or (...,) float, lengths of the direction
            Broadcast to the rays. Only crossings with t_min <= t <= t_max count, as far as float32 can tell; t_min is
            at least 0.
        mask : int or (...,) int, optional
            32 bits, broadcast to the rays: each sees only the instances whose mask shares a bit with its own; without
            it, all of them.
        progress : function, optional
            Called with the number of rays that are done, and of all rays, after each piece of the work.

        Returns
        -------
        Hits
            In the leading shape that the rays are broadcast to, () for a single ray; in float64. At equal distance the
            smaller face number wins.

        Raises
        ------
        QueryError
            Shapes that are wrong or do not broadcast, a value that is not finite, a direction of length zero, a
            negative t_min: the message names the first bad ray. Or the tracer is closed.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())  # from -0.5 to 0.5
        >>> origins, directions = [[0.1, 0.2, 5], [3, 0, 5]], [[0, 0, -1], [0, 0, -1]]
        >>> hits = tracer.closest_hit(origins, directions)
        >>> hits.t
        array([4.5, inf])
        >>> hits.locations[hits.is_hit]
        array([[0.1, 0.2, 0.5]])
        >>> tracer.closest_hit(origins, directions, t_min=5).t
        array([5.5, inf])
        """
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        caster = self._caster
        return find_closest_hits(caster, batch, shape, progress)

    def closest_prim(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int32]:
        """Return (...,) int32: the face that `closest_hit` finds, -1 on a miss; with less work on the host.

        Parameters and errors are those of `closest_hit`.

        Examples
        --------
        >>> import clbvh
        >>> square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> clbvh.Tracer(square).closest_prim([[0.7, 0.2, 1], [0.2, 0.7, 1]], [[0, 0, -1], [0, 0, 1]])
        array([ 0, -1], dtype=int32)
        """
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        return find_closest_prims(self._caster, batch, shape, progress)

    def any_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Return (...,) bool: whether each ray hits anything, which takes less time than the closest hit.

        Parameters and errors are those of `closest_hit`.

        Examples
        --------
        Is the line between two points free?

        >>> import clbvh
        >>> import numpy as np
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())
        >>> start, end = np.array([[-2, 0, 0], [-2, 2, 0]]), np.array([[2, 0.1, 0], [2, 2, 0]])
        >>> tracer.any_hit(start, end - start, t_max=1)
        array([ True, False])
        """
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        return find_any_hits(self._caster, batch, shape, progress)

    def count_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int32]:
        """Return (...,) int32: how often each ray crosses the mesh; a shared edge or vertex is one crossing.

        Parameters and errors are those of `closest_hit`; counting stops at `max_hits`, at least 1.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())
        >>> tracer.count_hits([[0.5, 0.5, 5], [0, 0, 0]], [[0, 0, -1], [0, 0, 1]])  # along an edge; from inside
        array([2, 1], dtype=int32)
        """
        limit = _check_max_hits(max_hits)
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        return count_hits(self._caster, batch, shape, limit, progress)

    def all_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        with_locations: bool = False,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> AllHits:
        """Return every crossing of each ray, in the order along it; a shared edge or vertex is one crossing.

        Parameters and errors are those of `closest_hit`; rays are numbered in C order. `max_hits`, at least 1, keeps
        the nearest crossings of each ray; `with_locations` computes the locations at once, which is faster than later.

        Notes
        -----
        Each ray is traversed once; rays with eight crossings or more a second time, with 32 or more a third time, and
        so on by factors of four. 28 bytes per crossing come back, and 40 MiB at a time are on the device; a ray with
        more gets the room it needs.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.annulus(r_min=1, r_max=2, height=1))
        >>> hits = tracer.all_hits([[-5, 0.1, 0]], [[1, 0, 0]])
        >>> hits.counts
        array([4])
        >>> (hits.t[1::2] - hits.t[::2]).round(2)  # length of the ray in the material
        array([1., 1.])
        """
        limit = _check_max_hits(max_hits)
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        caster = self._caster
        return find_all_hits(caster, batch, shape, limit, progress, with_locations=with_locations)

    def hits_by_depth(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        with_locations: bool = False,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64] | None]:
        """Return the crossings that `all_hits` finds: the first ones of all rays, then the second ones, and so on.

        Parameters and errors are those of `all_hits`.

        Returns
        -------
        prim_id : (m,) int64
            Faces of the mesh.
        ray_id : (m,) int64
            The ray of each crossing, in the order of the rays at each depth.
        locations : (m, 3) float64, the file's coordinates, or None
            Only found `with_locations`.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())
        >>> prim_id, ray_id, locations = tracer.hits_by_depth(
        ...     [[0.1, 0.2, 5], [0.1, 0.3, 5]], [[0, 0, -1], [0, 0, -1]], with_locations=True
        ... )
        >>> ray_id
        array([0, 1, 0, 1])
        >>> locations[:, 2]
        array([ 0.5,  0.5, -0.5, -0.5])
        """
        limit = _check_max_hits(max_hits)
        batch, shape = self._read_rays(origins, directions, t_min, t_max, mask)
        caster = self._caster
        return find_hits_by_depth(caster, batch, shape, limit, progress, with_locations=with_locations)

    def closest_point(
        self,
        points: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | None = None,
        instance: Instance | int | Iterable[Instance | int] | None = None,
        progress: Progress | None = None,
    ) -> ClosestPoints:
        """Return the closest point of the surface for each point.

        Parameters
        ----------
        points : (..., 3) float, the file's coordinates
        mask : int or (...,) int, optional
            32 bits, broadcast to the points: each sees only the instances whose mask shares a bit with its own; without
            it, all.
        geometry : Geometry, optional
            Of the tracer's scene: only its instances are seen.
        instance : Instance, id, or several of them, optional
            Of the tracer's scene: only they are seen.
        progress : function, optional
            Called with the number of points that are done, and of all points, after each piece of the work.

        Returns
        -------
        ClosestPoints
            Distance, point and primitive, in the leading shape of the points, in float64; of a scene also the ids of
            the geometry and of the instance. On an edge or a vertex, the smallest face number there; of equally near
            instances the smallest, as far as float32 can tell. Degenerate triangles have no closest point. Where
            nothing is seen, the distance is infinite.

        Raises
        ------
        QueryError
            Wrong shape, or a value that is not finite: the message names the first bad point. Or the tracer is closed.
        ConfigError
            A geometry or an instance is named, but the tracer has no scene.
        SceneError
            The geometry or the instance is not one of the scene.

        Notes
        -----
        Distances are those of the scene under any transform, with which spheres may become ellipsoids. A point of a
        sphere's surface has no u and v; the middle of a sphere has one of the closest points.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())
        >>> closest = tracer.closest_point([[0.1, 0.2, 2], [0.5, 3.5, 4.5]])
        >>> closest.distance
        array([1.5, 5. ])
        >>> closest.point
        array([[0.1, 0.2, 0.5],
               [0.5, 0.5, 0.5]])

        In a scene:

        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.Spheres([[0, 0, 0]], 1))
        >>> left, right = scene.place(ball), scene.place(ball, clbvh.Transform(translate=(5, 0, 0)))
        >>> tracer = clbvh.Tracer(scene)
        >>> tracer.closest_point([[2, 0, 0], [3, 0, 0]]).instance_id
        array([0, 1], dtype=int32)
        >>> tracer.closest_point([2, 0, 0], instance=right).distance
        array(2.)
        """
        caster = self._caster
        return closest_points(caster, self._see(points, mask, geometry, instance), progress)

    def contains(
        self,
        points: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | None = None,
        instance: Instance | int | Iterable[Instance | int] | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Return (...,) bool: whether a closed mesh, or anything in a scene, contains each point.

        A point is inside a mesh if a ray from it crosses the surface an odd number of times. So the orientation of
        triangles does not matter, and a point inside two nested shells is outside. It is inside spheres if it is in one
        of them, and inside a scene if it is in one of the instances that it sees. On the surface, as far as float32 can
        tell, the answer is either. Parameters and errors are those of `closest_point`.

        Warns
        -----
        OpenMeshWarning
            Once for each tracer, if a mesh that is asked for is not closed (`Mesh.is_watertight`): the answer is not
            defined.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> clbvh.Tracer(trimesh.creation.box()).contains([[0.4, 0.4, 0.4], [0.4, 0.4, 0.6]])
        array([ True, False])
        """
        caster, seen = self._caster, self._see(points, mask, geometry, instance)
        self._warn_if_open("contains", caster, seen)
        return is_contained(caster, seen, progress)

    def signed_distance(
        self,
        points: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | None = None,
        instance: Instance | int | Iterable[Instance | int] | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Return (...,) float64: the distance to the surface of a closed mesh, positive inside, negative outside.

        The distance is that of `closest_point`, the sign that of `contains`, as is the warning. Parameters and errors
        are those of `closest_point`.

        Inside a scene it is the distance to the surface of one instance: of those that contain the point, the one whose
        surface is the farthest. So it is exact where instances do not overlap. Where they do, the surface of their
        union is at least as far, and the same holds for spheres that overlap. Where nothing is seen, it is minus
        infinity.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> clbvh.Tracer(trimesh.creation.box()).signed_distance([[0, 0, 0.25], [0, 0, 2]])
        array([ 0.25, -1.5 ])
        """
        caster, seen = self._caster, self._see(points, mask, geometry, instance)
        self._warn_if_open("signed_distance", caster, seen)
        return signed_distances(caster, seen, progress)

    def ambient_occlusion(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        *,
        rays: int = 64,
        max_distance: ArrayLike = np.inf,
        seed: int = 0,
        offset: float = 0.0,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Return how open the surroundings of each point are: 1 under a free sky, 0 where every way out is blocked.

        It is the share of the hemisphere over the point from which light would arrive, weighted by the cosine to the
        normal as light on a matt surface is; ambient occlusion, or the sky view factor.

        Parameters
        ----------
        points : (..., 3) float, the file's coordinates
            On the surface, or anywhere.
        normals : (..., 3) float, any length above 0
            Broadcast against the points. Rays go to the side to which a normal points.
        rays : int
            Rays over each point. The error falls nearly as 1 / rays; powers of two are best.
        max_distance : float or (...,) float, the file's units
            Broadcast to the points. What is farther away blocks nothing.
        seed : int
            Other seeds draw other rays.
        offset : float, the file's units
            By how much points are lifted along their normals, beside the rounding of float32 and of the points' own
            dtype. Needed for points that lie below the surface.
        mask : int or (...,) int, optional
            As in `closest_hit`.
        progress : function, optional
            Called with the number of points that are done, and of all points, after each piece of the work.

        Returns
        -------
        (...,) float64
            From 0 to 1, in steps of 1 / rays, in the shape that points and normals are broadcast to.

        Raises
        ------
        QueryError
            Shapes that are wrong or do not broadcast, a value that is not finite, a normal of length zero, a
            negative max_distance or offset: the message names the first bad point. Or the tracer is closed.
        ConfigError
            rays or seed is no integer, or out of range.

        Notes
        -----
        The rays of a point are Owen-scrambled Sobol points (Burley, "Practical hash-based Owen scrambling", 2020) that
        depend on its index and on the seed alone: the same points give the same bits in any layout, on any device that
        rounds as IEEE 754 says, and however the work is cut. Rays are drawn, cast and counted on the device.

        Points on the surface do not see it: they are lifted by about 10^-5 of the mesh's size, or of the size of the
        instances around them. A point that lies below by more than the rounding of its dtype is in the dark, see
        `offset`. If the normal is not that of the triangle, as normals of vertices are not, rays below the triangle
        are blocked by it.

        Examples
        --------
        A floor under the middle of a disk of radius 1 at a height of 1, which hides half of the sky, and aside:

        >>> import clbvh
        >>> import trimesh
        >>> disk = trimesh.creation.cylinder(radius=1, height=0.01, sections=256)
        >>> tracer = clbvh.Tracer(disk)
        >>> tracer.ambient_occlusion([[0, 0, -1], [5, 0, -1]], [0, 0, 1], rays=1024).round(2)
        array([0.5, 1. ])
        >>> tracer.ambient_occlusion([0, 0, -1], [0, 0, 1], max_distance=0.5)
        array(1.)
        """
        rays, seed = check_sampling(rays, seed)
        hemispheres = Hemispheres.read(points, normals, max_distance, mask, offset)
        return find_open_shares(self._caster, hemispheres, rays, seed, progress)

    def update(self, vertices: ArrayLike) -> None:
        """Move the vertices of the mesh: the tree is refitted and uploaded; buffers and kernels are kept.

        Later queries find the same hits as with a new tracer over the moved mesh; `sah_growth` tells when a new tracer
        would be faster.

        Parameters
        ----------
        vertices : (V, 3) float, the file's coordinates
            The same number as before; copied. Size and place of the mesh may change.

        Raises
        ------
        MeshError
            Another number of vertices, wrong shape or dtype, or vertices that `Mesh.from_arrays` refuses.
        QueryError
            The tracer is closed.
        DeviceError
            The device refuses, or this process was forked from one that has used OpenCL.

        Notes
        -----
        After an error or Ctrl-C the tracer is as before the update, or as after it.

        Updates wait for each other, but not for queries of other threads: a query that is running ends on the mesh
        that it began with. Results refer to the mesh that was hit (`Hits.mesh`) and keep their locations.

        A tree that is updated is on the device twice, and once more for each older mesh that queries of other threads
        still use. The host keeps about 15 bytes per triangle for `bvh8`, 24 for `bvh4` and 61 for `bvh2`. The tree that
        the tracer was made of does not change.

        Examples
        --------
        >>> import clbvh
        >>> vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        >>> with clbvh.Tracer((vertices, [[0, 1, 2]])) as tracer:
        ...     tracer.update([[0, 0, 1], [1, 0, 1], [0, 1, 1]])
        ...     tracer.closest_hit([[0.25, 0.25, 3]], [[0, 0, -1]]).t
        array([2.])
        """
        if self._scene is not None:
            raise ConfigError("a tracer of a scene moves one geometry: call set_vertices(geometry, vertices)")
        copies = cast(TreeCopies, self._copies)
        with self._caster.open_call() as call, self._updating:
            mesh = self.mesh.with_vertices(vertices)
            self._caster = copies.move(self._caster, mesh, call.memory.session)

    def set_transforms(self, instances: Instance | int | Iterable[Instance | int], transforms: ArrayLike) -> None:
        """Move instances of a scene: only the tree over the instances is built anew.

        Parameters
        ----------
        instances : Instance, int, or several
            Those to move, as `Scene.place` returned them, or their ids. The others stay where they are.
        transforms : (n, 4, 4) float
            From the coordinates of each instance's geometry to the scene's; (4, 4) for one.

        Raises
        ------
        SceneError
            An instance of another scene, or one that was placed after the tracer was opened; a matrix that is not
            finite, not affine, or singular; or an instance that is too small beside the scene.
        ConfigError
            This is no tracer of a scene.
        QueryError
            The tracer is closed.
        DeviceError
            The device refuses, or this process was forked from one that has used OpenCL.

        Notes
        -----
        Changes wait for each other, but not for queries: a query that is running ends on the scene that it began with.
        The scene that the tracer was opened with does not change.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.place(scene.add(clbvh.make_shape("icosphere", triangles=320)))
        >>> with clbvh.Tracer(scene) as tracer:
        ...     before = tracer.any_hit([[0, 0, 5]], [[0, 0, -1]])
        ...     tracer.set_transforms(ball, [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        ...     before, tracer.any_hit([[0, 0, 5], [9, 0, 5]], [[0, 0, -1], [0, 0, -1]])
        (array([ True]), array([False,  True]))
        """
        scene = self._known_scene()
        with self._caster.open_call() as call, self._updating:
            self._caster = scene.set_transforms(self._caster, instances, transforms, call.memory.session)

    def set_vertices(self, geometry: Geometry, vertices: ArrayLike) -> None:
        """Move the vertices of a geometry of a scene: its tree is refitted, or built anew where that pays.

        Parameters
        ----------
        geometry : Geometry
            As `Scene.add` returned it.
        vertices : (V, 3) float, the geometry's coordinates
            The same number as before; of spheres, their centres.

        Raises
        ------
        MeshError
            Another number of vertices, wrong shape or dtype, or vertices that `Mesh.from_arrays` refuses.
        SceneError
            A geometry of another scene, or one that was added after the tracer was opened.
        ConfigError, QueryError, DeviceError
            As of `set_transforms`.

        Notes
        -----
        A tree whose SAH cost has grown by 1.3 is built anew, and so are those of spheres. See `set_transforms`.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> mesh = clbvh.make_shape("icosphere", triangles=320)
        >>> ball = scene.add(mesh)
        >>> aside = [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        >>> first, second = scene.place(ball), scene.place(ball, aside)
        >>> with clbvh.Tracer(scene) as tracer:
        ...     tracer.set_vertices(ball, mesh.vertices * 0.5)
        ...     tracer.any_hit([[0.7, 0, 5], [9.7, 0, 5], [9.4, 0, 5]], [0, 0, -1])
        array([False, False,  True])
        """
        scene = self._known_scene()
        with self._caster.open_call() as call, self._updating:
            self._caster = scene.set_vertices(self._caster, geometry, vertices, call.memory.session)

    def _known_scene(self) -> MovingScene:
        if self._scene is None:
            raise ConfigError("this tracer has no instances: open it with a clbvh.Scene, or call update(vertices)")
        return self._scene

    @property
    def mesh(self) -> Mesh:
        """The mesh as it is now.

        Raises
        ------
        ConfigError
            The tracer has a scene of several objects.
        """
        mesh = self._caster.tree.mesh
        if mesh is None:
            raise ConfigError("a tracer of a scene has no single mesh: see scene.geometries")
        return mesh

    @property
    def sah_growth(self) -> float:
        """The SAH cost of the tree now, divided by its cost when the tracer was opened.

        1 until the first `update`; moving or scaling the whole mesh does not change it. Rays slow down by less than
        this factor, and a new tree would share part of it: larger triangles cost more in any tree. From about 2 on, a
        new tracer may be faster.
        """
        tree: object = self._caster.tree
        return tree.sah_growth if isinstance(tree, DeviceTree) else 1.0

    @property
    def device(self) -> DeviceInfo:
        """The device that the tree is on."""
        return self._caster.session.info

    @property
    def layout(self) -> str:
        """The layout that the tree has on the device."""
        return self._caster.tree.layout

    @property
    def memory_bytes(self) -> int:
        """Device memory that trees, primitives and instances take; the first `update` of a mesh doubles it."""
        tree = self._caster.tree
        return (
            tree.memory_bytes if self._copies is None or not isinstance(tree, DeviceTree) else self._copies.memory_bytes
        )

    @property
    def timings_ms(self) -> dict[str, float]:
        """Milliseconds on the device so far, in all threads: upload, kernel, download."""
        return self._caster.session.times.sums_ms()

    @property
    def is_closed(self) -> bool:
        """Whether the tracer takes no more queries."""
        return self._caster.calls.is_closed

    def close(self) -> None:
        """Give the device's memory back. Closing twice is allowed.

        Queries that other threads are running end first, and get their results; later ones raise `QueryError`.

        Examples
        --------
        >>> import clbvh
        >>> tracer = clbvh.Tracer(clbvh.make_shape("icosphere", triangles=1000))
        >>> tracer.close()
        >>> tracer.is_closed
        True
        """
        self._caster.close()

    def _read_rays(
        self, origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None
    ) -> tuple[RayBatch, tuple[int, ...]]:
        """Return rays as a batch. A mesh without instances is seen by every mask but 0."""
        batch, shape = read_rays(origins, directions, t_min, t_max, mask)
        if batch.mask is None or self._caster.tree.has_instances:
            return batch, shape
        return read_rays(origins, directions, t_min, np.where(np.asarray(mask) == 0, -np.inf, t_max))

    def _see(
        self,
        points: ArrayLike,
        mask: ArrayLike | None,
        geometry: Geometry | None,
        instance: Instance | int | Iterable[Instance | int] | None,
    ) -> SeenPoints:
        """Return points with the instances that are visible to them."""
        chosen = None
        if geometry is not None or instance is not None:
            chosen = self._known_scene().choose_instances(geometry, instance)
        return SeenPoints.read(points, mask, chosen)

    def _warn_if_open(self, query: str, caster: Caster, seen: SeenPoints) -> None:
        """Warn once that a mesh has no inside, on behalf of the public method `query`."""
        if self._has_warned:
            return
        tree: object = caster.tree
        shapes = tree.shapes_of(seen.instance_ids) if isinstance(tree, DeviceScene) else [caster.tree.mesh]
        shape = next((shape for shape in shapes if not shape.is_watertight), None)
        if shape is None:
            return
        self._has_warned = True
        warnings.warn(
            f"{shape.name} is not closed, so it has no inside: the answer of {query} is not defined where a ray "
            "can leave through a hole",
            OpenMeshWarning,
            stacklevel=3,
        )

    def __repr__(self) -> str:
        mesh = self._caster.tree.mesh
        name = "scene" if mesh is None else mesh.name
        return f"Tracer({name!r}, device={self.device.name!r}, layout={self.layout!r})"


def _open_scene(contents: SceneContents) -> MovingScene:
    """Return the scene with the trees of its geometries."""
    from ..builders.build import build, build_shape

    return MovingScene(contents, build_shape, partial(build, leaf_size=1))


def _find_tree(source: Bvh | MeshLike) -> Bvh:
    """Return the tree of a tracer's source."""
    if isinstance(source, Bvh):
        return source
    mesh = as_mesh(source, or_else="a clbvh.Bvh")
    # Not above: a tracer of a finished tree needs no builder.
    from ..builders.build import build

    return build(mesh)


def _check_max_hits(max_hits: int | None) -> int | None:
    """Raise unless this is no limit, or one that a kernel can hold."""
    is_number = isinstance(max_hits, Integral) and not isinstance(max_hits, bool)
    if max_hits is not None and not (is_number and 1 <= max_hits <= NO_LIMIT):
        raise ConfigError(f"max_hits must be None or a number from 1 to {NO_LIMIT}, not {max_hits}")
    return max_hits

"""The queries of a tracer about points: their arguments, results, errors and warnings.

How points are looked up is in `points/`.
"""

from __future__ import annotations

import warnings
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ClbvhWarning, ConfigError, OpenMeshWarning, QueryError
from ..scene.handles import Geometry, Instances
from .launch import Caster, HasCaster
from .points.ambient_occlusion import Hemispheres, check_sampling, find_open_shares
from .points.batch import SeenPoints
from .points.queries import (
    find_closest,
    find_contained,
    find_in_boxes,
    find_nearest_points,
    find_signed,
    find_within,
)
from .points.refine import AllClosestPoints, ClosestPoints
from .points.winding import (
    DEFAULT_ERROR,
    WINDING,
    WindingTrees,
    check_rule,
    find_windings,
    find_wound,
    find_wound_distances,
)
from .rays.batch import broadcast_shape, read_vectors
from .rays.pieces import Progress


class PointQueries(HasCaster):
    """The queries of a `Tracer` whose arguments are points."""

    # Whether somebody was told that a mesh has no inside.
    _has_warned = False
    # Of winding numbers; of a twin, its own.
    _winding_trees: WindingTrees

    def closest_point(
        self,
        points: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        max_distance: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> ClosestPoints:
        """Return the closest point of the surface for each point.

        Parameters
        ----------
        points : (..., 3) float, the file's coordinates
        mask : int or (...,) int, optional
            32 bits, broadcast to the points: each sees only the instances whose mask shares a bit with its own; without
            it, all.
        geometry : Geometry or str, optional
            Of the tracer's scene: only its instances are seen.
        instance : Instance, int or str, or several, optional
            Of the tracer's scene, by handle, id or name: only they are seen.
        max_distance : float or (...,) float, the scene's unit
            Broadcast to the points. What is farther away is not looked for, which takes less time.
        progress : function, optional
            Called with the number of points that are done, and of all points, after each piece of the work.

        Returns
        -------
        ClosestPoints
            Distance, point and primitive, in the leading shape of the points, in float64; of a scene also the ids of
            the geometry and of the instance; u, v, normals and `interpolate` as of `Hits`. On an edge or a vertex, the
            smallest face number there; of equally near instances the smallest, as far as float32 can tell. Degenerate
            triangles have no closest point. Where nothing is seen so near, the distance is infinite.

        Raises
        ------
        QueryError
            Wrong shape, a value that is not finite, or a negative max_distance: the message names the first bad point.
            Or the tracer is closed.
        SceneError
            The geometry or the instance is not one of the scene.

        Notes
        -----
        Distances are those of the scene under any transform, with which spheres may become ellipsoids. The
        middle of a sphere has one of the closest points.

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
        caster, seen = self._caster, self._see(points, mask, geometry, instance, max_distance)
        return find_closest(caster, seen, progress)

    def closest_points(
        self,
        points: ArrayLike,
        k: int,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        max_distance: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> ClosestPoints:
        """Return the k nearest primitives of each point, nearest first, with the closest point of each.

        Parameters
        ----------
        points, mask, geometry, instance, max_distance, progress
            As in `closest_point`.
        k : int
            At least 1.

        Returns
        -------
        ClosestPoints
            As of `closest_point`, in the leading shape of the points and k. Where fewer than k are seen, the rest has
            distance inf, point NaN, and ids -1.

        Raises
        ------
        ConfigError
            k is no integer of at least 1.
        QueryError, SceneError
            As in `closest_point`.

        Notes
        -----
        Exact in float64, where `closest_point` chooses in float32: no primitive that is left out is nearer. Ties, to
        2^-46 of distance and coordinates, are in the order of (instance, primitive). A point farther away than 512
        times half the size of the scene sees it as from there. Where very many primitives are equally near, as from
        the middle of a round shape, a point takes as much time and memory as these.

        Examples
        --------
        >>> import clbvh
        >>> balls = clbvh.Spheres([[0, 0, 0], [4, 0, 0], [9, 0, 0]], 1)
        >>> closest = clbvh.Tracer(clbvh.Scene(balls)).closest_points([[3, 0, 2], [8, 0, 0]], 2)
        >>> closest.prim_id
        array([[1, 0],
               [2, 1]], dtype=int32)
        >>> closest.distance.round(2)
        array([[1.24, 2.61],
               [0.  , 3.  ]])
        """
        if not isinstance(k, Integral) or isinstance(k, bool) or k < 1:
            raise ConfigError(f"k must be an integer of at least 1, not {k!r}")
        caster, seen = self._caster, self._see(points, mask, geometry, instance, max_distance)
        return find_nearest_points(caster, seen, int(k), progress)

    def prims_within(
        self,
        points: ArrayLike,
        distance: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        progress: Progress | None = None,
    ) -> AllClosestPoints:
        """Return all primitives within a distance of each point, nearest first, with the closest point of each.

        Parameters
        ----------
        points, mask, geometry, instance, progress
            As in `closest_point`.
        distance : float or (...,) float, the scene's unit
            Broadcast to the points.

        Returns
        -------
        AllClosestPoints
            As of `closest_points`, grouped by point; ``counts`` are the numbers of primitives.

        Raises
        ------
        QueryError, SceneError
            As in `closest_point`.

        Examples
        --------
        >>> import clbvh
        >>> terrain = clbvh.make_shape("terrain", triangles=2000)
        >>> near = clbvh.Tracer(terrain).prims_within(terrain.vertices[[0, 500]], 1e-9)
        >>> near.counts  # faces around a corner of the terrain, and around a vertex
        array([2, 6])
        """
        caster, seen = self._caster, self._see(points, mask, geometry, instance, distance, "distance")
        return find_within(caster, seen, progress)

    def prims_in_boxes(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        progress: Progress | None = None,
    ) -> AllClosestPoints:
        """Return all primitives that meet each of some upright boxes, or touch them as far as float64 can tell.

        Parameters
        ----------
        lower, upper : (..., 3) float, the scene's coordinates
            The corners of the boxes, broadcast against each other; coordinates may be infinite.
        mask, geometry, instance, progress
            As in `closest_point`.

        Returns
        -------
        AllClosestPoints
            Grouped by box, with the points that are closest to the middle of the box, of an infinite one within the
            scene; ``counts`` are the numbers of primitives. Spheres are surfaces and what is inside of them.

        Raises
        ------
        QueryError
            As in `closest_point`, or a box whose upper corner is below its lower one.
        SceneError
            As in `closest_point`.

        Notes
        -----
        Decided in float64, for triangles by the theorem of separating axes (Akenine-Moeller, "Fast 3D triangle-box
        overlap testing", 2001).

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> cube = clbvh.Tracer(trimesh.creation.box())  # from -0.5 to 0.5
        >>> cube.prims_in_boxes([[0.4, -0.1, -0.1], [-0.1, -0.1, -0.1]], [[0.6, 0.1, 0.1], [0.1, 0.1, 0.1]]).counts
        array([2, 0])
        """
        corners = [
            read_vectors(corner, name).astype(np.float64) for corner, name in ((lower, "lower"), (upper, "upper"))
        ]
        try:
            shape = broadcast_shape(corners[0].shape[:-1], corners[1].shape[:-1])
        except ValueError:
            raise QueryError(
                f"lower {corners[0].shape} and upper {corners[1].shape} must have shapes that broadcast"
            ) from None
        below, above = (np.broadcast_to(corner, (*shape, 3)).reshape(-1, 3) for corner in corners)
        if not (below <= above).all():
            box = int(np.argmin((below <= above).all(axis=1)))
            raise QueryError(f"box {box} has no upper corner above its lower one: {below[box]}, {above[box]}")
        below, above = (np.ascontiguousarray(corner) for corner in (below, above))
        with np.errstate(invalid="ignore"):  # of infinite boxes
            middles = below / 2 + above / 2
        caster, seen = self._caster, self._see(middles, mask, geometry, instance)
        return find_in_boxes(caster, below, above, seen, progress)

    def contains(
        self,
        points: ArrayLike,
        *,
        rule: str = "parity",
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Return (...,) bool: whether a closed mesh, or anything in a scene, contains each point.

        A point is inside a mesh if a ray from it crosses the surface an odd number of times. So the orientation of
        triangles does not matter, and a point inside two nested shells is outside. It is inside spheres if it is in one
        of them, and inside a scene if it is in one of the instances that it sees. On the surface, as far as float32 can
        tell, the answer is either. Parameters and errors are those of `closest_point`.

        With ``rule="winding"`` it is inside where the `winding_number` of the mesh, or of one of the instances, is
        above a half or below minus a half. That closes holes, and a point inside two overlapping parts is inside.
        Triangles have to be oriented alike.

        Faces with the same three corners, as in exports with both sides, count so that the surface is closed: once
        where all faces that hang together are there twice, or where some are there once too often; as often as they are
        there where they are the common wall of two solids.

        Warns
        -----
        OpenMeshWarning
            Of the rule ``"parity"``, once for each tracer, if a mesh that is asked for is not closed
            (`Mesh.is_watertight`), not even when faces that coincide count once, or has faces that nearly coincide: the
            answer may not be the one that is meant.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> clbvh.Tracer(trimesh.creation.box()).contains([[0.4, 0.4, 0.4], [0.4, 0.4, 0.6]])
        array([ True, False])
        """
        caster, seen = self._caster, self._see(points, mask, geometry, instance)
        if check_rule(rule) == WINDING:
            return find_wound(caster, self._winding_trees, seen, progress)
        self._warn_if_open("contains", caster, seen)
        return find_contained(caster, seen, progress)

    def winding_number(
        self,
        points: ArrayLike,
        *,
        max_error: float = DEFAULT_ERROR,
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Return (...,) float64: the generalized winding number of each point, which needs no closed mesh.

        1 inside a closed mesh whose triangles run anticlockwise as seen from outside, -1 inside an inverted one, 0
        outside, and the sum where parts overlap. Over a hole it changes smoothly. In a scene it is the sum of all that
        the point sees. Other parameters and errors are those of `closest_point`.

        Parameters
        ----------
        max_error : float, optional
            The largest error, as measured on meshes of many kinds; the root mean square of errors is an eighth of it.
            0: the exact sum over all triangles, in float32.

        Raises
        ------
        ConfigError
            `max_error` is no number from 0.
        QueryError
            There are spheres.

        Notes
        -----
        Far groups of triangles are expanded up to the second order (Barill, Dickson, Schmidt, Levin and Jacobson, "Fast
        winding numbers for soups and clouds", 2018), near triangles are summed (Jacobson, Kavan and Sorkine-Hornung,
        2013). A tree of moments is fitted at the first use and after each move, in about 1.5 s for a million triangles
        on one core; 160 bytes for each triangle of each instance. On the surface itself the answer means nothing.

        Examples
        --------
        A box without its lid:

        >>> import clbvh
        >>> import trimesh
        >>> box = trimesh.creation.box()
        >>> box.update_faces(box.face_normals[:, 2] < 0.5)
        >>> with clbvh.Tracer(box) as tracer:
        ...     tracer.winding_number([[0, 0, 0], [0, 0, 0.5], [0, 0, 2], [2, 0, 0]]).round(2)
        array([ 0.83,  0.5 ,  0.03, -0.01])
        """
        if isinstance(max_error, bool) or not (isinstance(max_error, Real) and max_error >= 0):
            raise ConfigError(f"max_error must be a number from 0, not {max_error!r}")
        seen = self._see(points, mask, geometry, instance)
        error = float(min(max_error, 1.0))
        return find_windings(self._caster, self._winding_trees, seen, error, progress)

    def signed_distance(
        self,
        points: ArrayLike,
        *,
        rule: str = "parity",
        mask: ArrayLike | None = None,
        geometry: Geometry | str | None = None,
        instance: Instances | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float64]:
        """Return (...,) float64: the distance to the surface of a closed mesh, positive inside, negative outside.

        The distance is that of `closest_point`, the sign that of `contains` by the same `rule`, as is the warning.
        Other parameters and errors are those of `closest_point`.

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
        if check_rule(rule) == WINDING:
            return find_wound_distances(caster, self._winding_trees, seen, progress)
        self._warn_if_open("signed_distance", caster, seen)
        return find_signed(caster, seen, progress)

    def ambient_occlusion(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        *,
        rays: int = 64,
        max_distance: ArrayLike = np.inf,
        seed: int = 0,
        offset: float = 0.0,
        first_number: int = 0,
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
        normals : (..., 3) float, any length
            Broadcast against the points. Rays go to the side to which a normal points. A point whose normal is NaN or
            zero, as those of vertices in no face are, gets 1, with a `ClbvhWarning`.
        rays : int
            Rays over each point. The error falls nearly as 1 / rays; powers of two are best.
        max_distance : float or (...,) float, the file's units
            Broadcast to the points. What is farther away blocks nothing.
        seed : int
            Other seeds draw other rays.
        offset : float, the file's units
            By how much points are lifted along their normals, beside the rounding of float32 and of the points' own
            dtype. Needed for points that lie below the surface.
        first_number : int
            Of the first point, on whose number its rays depend: a part of an array that begins there gets the bits that
            it gets within the whole.
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
            Shapes that are wrong or do not broadcast, a point that is not finite, an infinite normal, a negative
            max_distance or offset: the message names the first bad point. Or the tracer is closed.
        ConfigError
            rays, seed or first_number is no integer, or out of range.

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
        rays, seed, first_number = check_sampling(rays, seed, first_number)
        hemispheres = Hemispheres.read(points, normals, max_distance, mask, offset)
        shares, lost_count = find_open_shares(self._caster, hemispheres, rays, seed, first_number, progress)
        if lost_count:
            text = f"{lost_count:,} of {shares.size:,} normals are NaN or zero: ambient_occlusion is 1 there"
            warnings.warn(text, ClbvhWarning, stacklevel=2)
        return shares

    def _see(
        self,
        points: ArrayLike,
        mask: ArrayLike | None,
        geometry: Geometry | str | None,
        instance: Instances | None,
        max_distance: ArrayLike = np.inf,
        name: str = "max_distance",
    ) -> SeenPoints:
        """Return points with the instances that are visible to them."""
        chosen = None
        if geometry is not None or instance is not None:
            chosen = self._changes.choose_instances(geometry, instance)
        return SeenPoints.read(points, mask, chosen, max_distance, name)

    def _warn_if_open(self, query: str, caster: Caster, seen: SeenPoints) -> None:
        """Warn once that a mesh has no inside, on behalf of the public method `query`."""
        if self._has_warned:
            return
        for shape in caster.world.shapes_of(seen.instance_ids):
            if not shape.is_watertight:
                reason = "is not closed, so it has no inside: the answer of {} is not defined where a ray can leave "
                reason += "through a hole"
            elif shape.coincidence.is_closed is False:
                reason = "has faces that coincide, and encloses nothing where each of them counts once: points there "
                reason += "are outside for {}"
            elif shape.coincidence.has_shifted:
                reason = "has faces that nearly coincide with others: {} counts each of them, so the answer is not "
                reason += "defined if they are meant to be the same; merge their vertices first"
            else:
                continue
            self._has_warned = True
            remedy = "rule='winding' tells inside from outside by all faces around a point"
            warnings.warn(f"{shape.name} {reason.format(query)}; {remedy}", OpenMeshWarning, stacklevel=3)
            return

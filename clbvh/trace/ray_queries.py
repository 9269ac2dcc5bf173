"""The queries of a tracer that cast rays: their arguments, results and errors.

How rays are cast is in `hits/`.
"""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral
from typing import Any, Literal, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError
from ..geometry.arrays import is_device_array
from ..scene.handles import Instances
from .hits.all_hits import find_all_hits
from .hits.closest import NO_LIMIT, count_hits, find_any_hits, find_closest_hits, find_closest_prims
from .hits.device_hits import DeviceHits, download_hits, find_hits_on_device, put_hits
from .hits.hits import AllHits, Hits
from .hits.points_on import place_points
from .hits.surface import Surface
from .launch import Caster, HasCaster
from .points.refine import ClosestPoints
from .put_rays import put_vectors
from .rays.batch import RayBatch, find_origins, read_device_rays, read_rays, read_unmasked_rays, read_vectors
from .rays.pieces import Progress


class RayQueries(HasCaster):
    """The queries of a `Tracer` whose arguments are rays."""

    @overload
    def closest_hit(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, *, t_min: ArrayLike = ...,
        t_max: ArrayLike = ..., mask: ArrayLike | None = ..., side: str | None = ...,
        exclude: ArrayLike | Hits | ClosestPoints | None = ..., progress: Progress | None = ...,
        out: Literal["host"] = ...,
    ) -> Hits: ...  # fmt: skip

    @overload
    def closest_hit(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, *, t_min: ArrayLike = ...,
        t_max: ArrayLike = ..., mask: ArrayLike | None = ..., side: str | None = ...,
        exclude: ArrayLike | Hits | ClosestPoints | None = ..., progress: Progress | None = ...,
        out: Literal["device"],
    ) -> DeviceHits: ...  # fmt: skip

    def closest_hit(
        self,
        origins: ArrayLike | Hits | ClosestPoints,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None,
        progress: Progress | None = None,
        out: str = "host",
    ) -> Hits | DeviceHits:
        """Return the nearest hit of each ray, from either side of the triangles.

        Parameters
        ----------
        origins : (..., 3) float, the file's coordinates; or Hits, or ClosestPoints
            Of any leading shape. Rays of shape (height, width, 3) are those of a picture, which are cast tile by tile.
            Rays that leave a surface begin next to it, on the side to which each direction leads: see
            `Hits.offset_origins`, and `points_on` for points that nothing has found.
        directions : (..., 3) float, any length above 0
            Broadcast against the origins, without copies: one origin (3,) for many directions (n, 3), or (n, 1, 3) with
            (m, 3) for all pairs. Origins and directions, of this query and of others, may be a
            `pyopencl.array.Array`: of float32 or float64 and in `Tracer.context`, it is read on the device.
        t_min, t_max : float or (...,) float, lengths of the direction
            Broadcast to the rays. Only hits with t_min <= t <= t_max count, as far as float32 can tell; t_min is
            at least 0.
        mask : int or (...,) int, optional
            32 bits, broadcast to the rays: each sees only the instances whose mask shares a bit with its own; without
            it, all of them.
        side : str, optional
            ``"front"`` or ``"back"``: only hits on this side of the primitives count, see `Hits.is_front`, as far as
            float32 can tell.
        exclude : Hits, ClosestPoints, or (...,) int, optional
            The primitive that each ray does not see, broadcast to the rays; -1 for none. Of a mesh in its own place,
            the numbers of faces will do.
        progress : function, optional
            Called with the number of rays that are done, and of all rays, after each piece of the work.
        out : str
            ``"device"``: the hits stay on the device.

        Returns
        -------
        Hits, or DeviceHits
            In the leading shape that the rays are broadcast to, () for a single ray; in float64. At equal distance the
            smaller face number wins.

        Raises
        ------
        QueryError
            Shapes that are wrong or do not broadcast, a value that is not finite, a direction of length zero, a
            negative t_min: the message names the first bad ray. Or the tracer is closed.
        ConfigError
            Another word for `out`.

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
        if out not in ("host", "device"):
            raise ConfigError(f"out must be 'host' or 'device', not {out!r}")
        caster, batch = self._read_rays(
            origins, directions, t_min, t_max, mask, side, exclude, are_refined=True, to_device=out == "device"
        )
        if not batch.is_on_device:
            hits = find_closest_hits(caster, batch, progress)
            return hits if out == "host" else put_hits(caster.session, hits)
        found = find_hits_on_device(caster, batch, progress)
        return found if out == "device" else download_hits(caster, found)

    def closest_prim(
        self,
        origins: ArrayLike | Hits | ClosestPoints,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None,
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
        caster, batch = self._read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        return find_closest_prims(caster, batch, progress)

    def any_hit(
        self,
        origins: ArrayLike | Hits | ClosestPoints,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike | None = None,
        side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None,
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
        caster, batch = self._read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        return find_any_hits(caster, batch, progress)

    def count_hits(
        self,
        origins: ArrayLike | Hits | ClosestPoints,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        mask: ArrayLike | None = None,
        side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int32]:
        """Return (...,) int32: the number of hits of each ray; a shared edge or vertex is one hit.

        Parameters and errors are those of `closest_hit`; counting stops at `max_hits`, at least 1.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> tracer = clbvh.Tracer(trimesh.creation.box())
        >>> tracer.count_hits([[0.5, 0.5, 5], [0, 0, 0]], [[0, 0, -1], [0, 0, 1]])  # along an edge; from inside
        array([2, 1], dtype=int32)
        """
        limit = check_max_hits(max_hits)
        caster, batch = self._read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        return count_hits(caster, batch, limit, progress)

    def all_hits(
        self,
        origins: ArrayLike | Hits | ClosestPoints,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        with_locations: bool = False,
        mask: ArrayLike | None = None,
        side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None,
        progress: Progress | None = None,
    ) -> AllHits:
        """Return all hits, grouped by ray and sorted by t; a shared edge or vertex is one hit.

        Parameters and errors are those of `closest_hit`; rays are numbered in C order. `max_hits`, at least 1, keeps
        the nearest hits of each ray; `with_locations` computes the locations at once, which is faster than later.

        Notes
        -----
        Each ray is traversed once; rays with eight hits or more a second time, with 32 or more a third time, and
        so on by factors of four. 28 bytes per hit come back, and 40 MiB at a time are on the device; a ray with
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
        limit = check_max_hits(max_hits)
        # Sorted and refined on the host.
        origins = read_vectors(find_origins(origins, directions), "origins")
        directions = read_vectors(directions, "directions")
        caster, batch = self._read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        return find_all_hits(caster, batch, limit, progress, with_locations=with_locations)

    def points_on(
        self, prim_id: ArrayLike, barycentrics: ArrayLike = (1 / 3, 1 / 3, 1 / 3), *, instance: Instances | None = None
    ) -> Hits:
        """Return points on the surface, by their faces, as hits of rays that begin there: t is 0.

        Rays may leave them: ``tracer.any_hit(tracer.points_on(faces), sun)``. See also `Hits.locations`,
        `Hits.normals` and `Hits.interpolate`.

        Parameters
        ----------
        prim_id : (...,) int
            Faces, by their numbers in their mesh.
        barycentrics : (..., 3) float, or (..., 2)
            Weights of the corners a, b and c, of sum 1, or u and v; broadcast. Centroids without it.
        instance : Instance, int or str, or several, optional
            Of the tracer's scene, by handle, id or name: one for each point, broadcast. The only one without it.

        Raises
        ------
        QueryError
            A face that the mesh does not have, weights that are not of a point on a triangle, shapes that do not
            broadcast, or no instance where there are several.
        SceneError
            The instance is not one of the scene.

        Examples
        --------
        Which faces see the sun:

        >>> import clbvh
        >>> knot, sun = clbvh.make_shape("knot", triangles=2000), [0, 1, 3]
        >>> with clbvh.Tracer(knot) as tracer:
        ...     points = tracer.points_on(range(knot.face_count))
        ...     in_light = (points.normals @ sun > 0) & ~tracer.any_hit(points, sun)
        >>> round(in_light.mean().item(), 2)
        0.42
        """
        world = self._caster.world
        instances = None if instance is None else self._changes.choose_instances(None, instance)
        return place_points(Surface.of_world(world), prim_id, barycentrics, instances)

    def _read_rays(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike,
        mask: ArrayLike | None, side: str | None, exclude: ArrayLike | Hits | ClosestPoints | None, *,
        are_refined: bool = False, to_device: bool = False,
    ) -> tuple[Caster, RayBatch]:  # fmt: skip
        """Return rays, in the host's memory or on the caster's device, with the caster that casts them."""
        # Read once, because an update may replace it by one that masks differently.
        caster, read = self._caster, cast(Callable[..., Any], read_rays)
        are_usual = type(origins) is type(directions) is np.ndarray
        starts: Any = origins if are_usual else find_origins(origins, directions)
        is_of_device = to_device or not (are_usual or not (is_device_array(starts) or is_device_array(directions)))
        if is_of_device and (vectors := put_vectors(caster, starts, directions, are_refined=are_refined)) is not None:
            read, (starts, directions) = read_device_rays, vectors
        is_lone = caster.world.is_lone
        if is_lone:
            batch = read_unmasked_rays(starts, directions, t_min, t_max, mask, read)
        else:
            batch = read(starts, directions, t_min, t_max, mask)
        return caster, batch.limit_sight(side, exclude, is_lone=is_lone)


def check_max_hits(max_hits: int | None) -> int | None:
    """Raise unless this is no limit, or one that a kernel can hold."""
    is_number = isinstance(max_hits, Integral) and not isinstance(max_hits, bool)
    if max_hits is not None and not (is_number and 1 <= max_hits <= NO_LIMIT):
        raise ConfigError(f"max_hits must be None or a number from 1 to {NO_LIMIT}, not {max_hits}")
    return max_hits

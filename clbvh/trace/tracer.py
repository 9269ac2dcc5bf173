"""Rays in numpy arrays go to the device, hits come back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..closing import Closing
from ..device.select import DeviceInfo
from ..device.session import DeviceSession
from ..layout import HIT
from ..tree import Bvh
from .caster import Caster, Progress
from .crossings import NO_LIMIT, count_crossings
from .device_tree import DeviceTree, check_layout
from .gather import gather_by_depth, gather_by_ray
from .hits import AllHits, Hits
from .nearest import find_closest, find_inside
from .points import ClosestPoints
from .rays import RayBatch, RayBox, read_rays, read_rows
from .refine import refine_hits


class Tracer(Closing):
    """Casts rays at one tree on one device; a context manager.

    Parameters
    ----------
    bvh : Bvh
    device : DeviceInfo, str, int or None
        The device: a number, part of its name, ``"gpu"`` or ``"cpu"``; without it a GPU, if there is one.
    layout : str
        ``"auto"``, ``"bvh2"``, ``"bvh4"`` or ``"bvh8"``.

    Raises
    ------
    DeviceError
        There is no such device, or the tree does not fit it.
    ConfigError
        An unknown layout.
    """

    def __init__(self, bvh: Bvh, *, device: DeviceInfo | str | int | None = None, layout: str = "auto") -> None:
        check_layout(layout)
        self._mesh = bvh.mesh
        session = DeviceSession(device)
        try:
            tree = DeviceTree(session, bvh.mesh, bvh, layout)
        except BaseException:
            session.close()
            raise
        self._caster = Caster(session, tree, RayBox.around(bvh))

    def closest_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> Hits:
        """Return the nearest crossing of each ray with the mesh, from either side of the triangles.

        Parameters
        ----------
        origins : (n, 3) float, the file's coordinates
        directions : (n, 3) float, any length above 0
        t_min, t_max : float or (n,) float, lengths of the direction
            Only crossings with t_min <= t <= t_max count, as far as float32 can tell; t_min is at least 0.
        progress : function, optional
            Called with the number of rays that are done, and of all rays, after each chunk.

        Returns
        -------
        Hits
            With n entries, in float64. At equal distance the smaller face number wins.

        Raises
        ------
        ValueError
            Wrong shape, a value that is not finite, a direction of length zero, a negative t_min: the message names
            the first bad row. Or the tracer is closed.
        """
        batch = read_rays(origins, directions, t_min, t_max)
        count = len(batch)
        hits = Hits(np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.int32), self._mesh)
        for begin, end in self._caster.ray_chunks(batch, progress):
            with self._caster.cast("closest_hit", end - begin, HIT) as found:
                self._refine(batch, begin, found, hits)
        return hits

    def closest_prim(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> NDArray[np.int32]:
        """Return (n,) int32: the face that `closest_hit` finds, -1 on a miss; it costs less on the host.

        Takes and raises the same as `closest_hit`.
        """
        batch = read_rays(origins, directions, t_min, t_max)
        prim_id = np.empty(len(batch), np.int32)
        for begin, end in self._caster.ray_chunks(batch, progress):
            with self._caster.cast("closest_hit", end - begin, HIT) as found:

                def copy(
                    first: int, last: int, prims: NDArray[np.int32] = found["prim_id"], begin: int = begin
                ) -> None:
                    prim_id[begin + first : begin + last] = prims[first:last]

                self._caster.threads.for_ranges(end - begin, copy)
        return prim_id

    def any_hit(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Return (n,) bool: whether anything lies on each ray, which is cheaper to find out than what is nearest.

        Takes and raises the same as `closest_hit`.
        """
        batch = read_rays(origins, directions, t_min, t_max)
        blocked = np.empty(len(batch), np.bool_)
        for begin, end in self._caster.ray_chunks(batch, progress):
            with self._caster.cast("any_hit", end - begin, np.dtype(np.uint8)) as found:
                blocked[begin:end] = found
        return blocked

    def count_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int32]:
        """Return (n,) int32: how often each ray crosses the mesh, where a shared edge or vertex is one crossing.

        Takes and raises the same as `closest_hit`, and stops counting at `max_hits`, at least 1.
        """
        limit = _check_max_hits(max_hits)
        return count_crossings(self._caster, read_rays(origins, directions, t_min, t_max), limit, progress)

    def all_hits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        with_locations: bool = False,
        progress: Progress | None = None,
    ) -> AllHits:
        """Return every crossing of each ray, in the order along it, where a shared edge or vertex is one crossing.

        Takes and raises the same as `closest_hit`. With `max_hits`, at least 1, each ray's nearest ones;
        `with_locations` finds the locations along with them, which is faster than later.

        Notes
        -----
        Each ray is traversed once; one with eight crossings and more twice, and one with 32 and more four times, to
        count them and to fetch them. 28 bytes per crossing come back, and 40 MiB at a time are on the device; a ray
        with more gets what it needs.
        """
        limit = _check_max_hits(max_hits)
        batch = read_rays(origins, directions, t_min, t_max)
        return gather_by_ray(self._caster, self._mesh, batch, limit, progress, with_locations=with_locations)

    def hits_by_depth(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        max_hits: int | None = None,
        with_locations: bool = False,
        progress: Progress | None = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64] | None]:
        """Return the crossings that `all_hits` finds, all rays' first ones before all second ones, and so on.

        Takes and raises the same as `all_hits`.

        Returns
        -------
        prim_id : (m,) int64
            Faces of the mesh.
        ray_id : (m,) int64
            The ray of each crossing, in the order of the rays at each depth.
        locations : (m, 3) float64, the file's coordinates, or None
            Only found `with_locations`.
        """
        limit = _check_max_hits(max_hits)
        batch = read_rays(origins, directions, t_min, t_max)
        return gather_by_depth(self._caster, self._mesh, batch, limit, progress, with_locations=with_locations)

    def closest_point(self, points: ArrayLike, *, progress: Progress | None = None) -> ClosestPoints:
        """Return the nearest point of the surface for each point.

        Parameters
        ----------
        points : (n, 3) float, the file's coordinates
        progress : function, optional
            Called with the number of points that are done, and of all points, after each chunk.

        Returns
        -------
        ClosestPoints
            Distance, point and face, in float64. Where an edge or a vertex is nearest, the smallest face number at it.
            Degenerate triangles are nobody's nearest.

        Raises
        ------
        ValueError
            Wrong shape, or a value that is not finite: the message names the first bad row. Or the tracer is closed.
        """
        return find_closest(self._caster, self._mesh, read_rows(points, "points"), progress)

    def contains(self, points: ArrayLike, *, progress: Progress | None = None) -> NDArray[np.bool_]:
        """Return (n,) bool: whether a closed mesh contains each point.

        A ray from the point crosses the surface an odd number of times; so which way the triangles face is of no
        matter, and what is inside of two shells is outside. On the surface, as far as float32 can tell, the answer is
        either. Takes and raises the same as `closest_point`.
        """
        return find_inside(self._caster, read_rows(points, "points"), progress)

    def signed_distance(self, points: ArrayLike, *, progress: Progress | None = None) -> NDArray[np.float64]:
        """Return (n,) float64: the distance to the surface of a closed mesh, positive inside and negative outside.

        The distance is that of `closest_point`, the sign that of `contains`. Takes and raises the same as
        `closest_point`.
        """
        rows = read_rows(points, "points")
        distance = find_closest(self._caster, self._mesh, rows, progress).distance
        return np.where(find_inside(self._caster, rows, None), distance, -distance)

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
        """Device memory that the tree and the triangles take."""
        return self._caster.tree.memory_bytes

    @property
    def timings_ms(self) -> dict[str, float]:
        """Milliseconds on the device so far: upload, kernel, download."""
        return self._caster.session.times.sums_ms()

    def close(self) -> None:
        """Give the device's memory back."""
        self._caster.close()

    def __repr__(self) -> str:
        return f"Tracer({self._mesh.name!r}, device={self.device.name!r}, layout={self.layout!r})"

    def _refine(self, batch: RayBatch, begin: int, found: NDArray[np.void], hits: Hits) -> None:
        """Write the hits of a chunk whose first ray is number `begin`."""

        def refine(first: int, last: int) -> None:
            rows = slice(begin + first, begin + last)
            refine_hits(
                batch.part(begin + first, begin + last), self._mesh, found[first:last],
                hits.t[rows], hits.u[rows], hits.v[rows], hits.prim_id[rows],
            )  # fmt: skip

        self._caster.threads.for_ranges(len(found), refine)


def _check_max_hits(max_hits: int | None) -> int | None:
    """Raise unless this is no limit, or one that a kernel can hold."""
    if max_hits is not None and not 1 <= max_hits <= NO_LIMIT:
        raise ValueError(f"max_hits must be None or a number from 1 to {NO_LIMIT}, not {max_hits}")
    return max_hits

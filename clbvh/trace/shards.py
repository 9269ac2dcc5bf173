"""A tracer of a mesh that is cut into shards: one of them at a time is in memory, and the answers are the whole mesh's.

Every decision of the whole mesh is made in float32, in its local coordinates. A shard has the same local vertices, and
its rays and points are packed in the box of the whole mesh, so a triangle of a shard has the crossing, or the distance,
that it has there. Of several crossings or distances, the whole mesh's answer is the least pair of t and face number;
float64 refines it afterwards. So answers of shards are compared by what the device found, before they are refined.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.info import DeviceInfo
from ..device.open import open_device
from ..device.session import DeviceSession
from ..errors import ConfigError, QueryError
from ..geometry import Mesh
from ..geometry.shards import Shard, read_shards
from ..scene.scene import Scene
from ..structs import FAR_POINT_SHARE, HIT, NO_PRIM, PACKED_RAY
from ..support.context_manager import ContextManager
from ..support.forks import make_lock
from .hits.all_hits import OFFSET_BITS, OFFSET_MASK, find_crossings, keep_order, refine_rays, running_sums
from .hits.closest import NO_LIMIT, count_hits
from .hits.hits import AllHits, Hits
from .hits.refine import LEAST_HITS, RefinedHits, refine_closest
from .hits.search import CLOSEST_HIT, Rays, cast_rays
from .hits.surface import Surface
from .launch import Caster, Query
from .points.batch import SeenPoints, take_points
from .points.queries import POINT_BYTES
from .points.refine import ClosestPoints, FoundPoints, refine_points
from .points.search import Points, look_up
from .ray_queries import check_max_hits
from .rays.batch import Broadcast, RayBatch, check_room, find_origins, read_unmasked_rays
from .rays.pack import pack_rays
from .rays.pieces import CHUNK_RAYS, Progress
from .world.surface_arrays import SurfacePoints, make_surface_arrays
from .world.tree_box import TreeBox
from .world.trees import check_layout
from .world.world import open_world

if TYPE_CHECKING:
    from ..builders.options import BuildOptions
    from ..bvh import Bvh

_CLOSEST_IN_SHARD = Query("closest_in_shard", "hits", HIT)

# t, u, v, prim_id, is_front and the device's t of a ray.
_HIT_BYTES = 33

# Rays or points that are compared with boxes at a time: a quarter of a MB of packed rays.
_COMPARED_ITEMS = 1 << 13

# How much farther than its box a primitive may seem to be, see cl/nearest/metric.cl: twice 32 roundings of float32,
# relative to the coordinates.
_POINT_SLACK = 2.0**-18

# No division by zero, where nothing is far.
_LEAST_SIZE = 2.0**-1000


# Crossings with a shard: their rays, the device's t, and the hits in float64.
_Crossed: TypeAlias = tuple[NDArray[np.int64], NDArray[np.float32], RefinedHits]


class _Opened(NamedTuple):
    """A shard in memory: its number, its faces' numbers in the whole mesh, and its world on the device."""

    number: int
    prim_ids: NDArray[np.int32]
    caster: Caster


class ShardedTracer(ContextManager):
    """Casts rays at a mesh that `shard_mesh` has cut, with one shard at a time in memory; a context manager.

    The answers are those of a `Tracer` of the whole mesh, byte for byte. Each query visits the shards that its rays
    meet, the nearest first, so it should have many rays: a visit reads the shard and, from the second one on, the tree
    that is kept beside it. Any number of threads may use one tracer; their queries run one after the other.

    Parameters
    ----------
    folder : str or path
        Of `shard_mesh`. Trees are kept there if it can be written to, about 15 bytes for each triangle.
    device : DeviceInfo, str, int or None
        As of a `Tracer`.
    layout : str
        As of a `Tracer`.
    quality : str
        As of a `Tracer`. Trees of ``"fast"`` are built at each visit, and not kept.
    shards : iterable of int, optional
        The only shards to look at, by number: for one shard, or a few, in each of several processes.

    Raises
    ------
    MeshError
        The folder has no shards, or its list of them is damaged. Damage of a shard is found by the first query that
        visits it.
    DeviceError
        There is no such device.
    ConfigError
        An unknown layout or quality, or a shard that is not there.

    Attributes
    ----------
    shards : tuple of Shard
        Those that it looks at.

    Notes
    -----
    Memory: a shard with its tree, on the host and on the device, the answers, and 8 bytes for each ray. Beside the
    answers, hits do not know their mesh: `Hits.mesh` is None. `locations`, `normals` and `offset_origins` visit the
    shards again; smooth normals, parts and `interpolate` need the whole mesh. Start points keep clear of acute edges
    within a shard, and not of those between two.

    Examples
    --------
    >>> import clbvh
    >>> terrain = clbvh.make_shape("terrain", triangles=2000)
    >>> _ = clbvh.shard_mesh(terrain, "parts", triangles=300)
    >>> origin, directions = terrain.origin + [0, 9, 0], [[0.1, -1, 0.2], [0.3, -1, -0.1]]
    >>> with clbvh.ShardedTracer("parts") as tracer, clbvh.Tracer(terrain) as whole:
    ...     hits, expected = tracer.closest_hit(origin, directions), whole.closest_hit(origin, directions)
    ...     hits.t.tobytes() == expected.t.tobytes(), bool((hits.locations == expected.locations).all())
    (True, True)
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        device: DeviceInfo | str | int | None = None,
        layout: str = "auto",
        quality: str = "default",
        shards: ArrayLike | None = None,
    ) -> None:
        # Imported here: it checks the quality.
        from ..builders.options import BuildOptions

        check_layout(layout)
        BuildOptions(quality=quality)
        found = read_shards(folder)
        try:
            self.shards: tuple[Shard, ...] = (
                found if shards is None else tuple(found[each] for each in np.ravel(shards))
            )
        except (IndexError, TypeError) as error:
            raise ConfigError(f"shards must be numbers of the {len(found)} in {folder}, not {shards!r}") from error
        self._box = TreeBox(found[0].origin, found[0].scale, found[0].half)
        # Without a triangle: an empty box that nothing meets.
        nothing = np.array([[np.inf] * 3, [-np.inf] * 3], np.float32)
        boxes = [nothing if shard.box is None else shard.box for shard in self.shards]
        self._boxes = np.array(boxes, np.float32).reshape(-1, 2, 3)
        self._session, self._layout, self._quality = open_device(device), layout, quality
        self._opened: _Opened | None = None
        self._lock = make_lock()

    @property
    def device(self) -> DeviceInfo:
        """The device on which the shards are traced."""
        return self._session.info

    @property
    def is_closed(self) -> bool:
        """Whether the tracer takes no more queries."""
        return self._session.is_closed

    def close(self) -> None:
        """Give the memory of the shard back. Closing twice is allowed; later queries raise `QueryError`."""
        with self._lock:
            self._release()
            self._session.close()

    def closest_hit(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, *, t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf, mask: ArrayLike | None = None, side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None, progress: Progress | None = None,
    ) -> Hits:  # fmt: skip
        """Return the nearest hit of each ray; see `Tracer.closest_hit`.

        `progress` is called after each shard, with the share of the rays that corresponds to it.

        Raises
        ------
        QueryError
            As `Tracer.closest_hit`.
        MeshError
            A shard is damaged, see `Shard.load`.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     hits = tracer.closest_hit([[0, 0, 5], [0.1, 0.2, 5]], [0, 0, -1])
        >>> hits.t.round(2), hits.normals.round(1)[1]
        (array([4.  , 4.03]), array([0. , 0.2, 1. ]))
        """
        batch = _read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        count = batch.ray_count
        check_room(count, _HIT_BYTES)
        hits = RefinedHits.make(count)
        hits.t[:], hits.u[:], hits.v[:], hits.is_front[:], hits.prim_id[:] = np.inf, 0.0, 0.0, False, NO_PRIM
        device_t = np.full(count, np.inf, np.float32)
        compare, visit = partial(_compare_rays, self._session), partial(_cast_closest, device_t=device_t, hits=hits)
        self._visit(batch, compare, device_t, visit, progress)
        return hits.reshape(*batch.shape).as_hits(ShardedSurface(self.shards))

    def closest_prim(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, *, t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf, mask: ArrayLike | None = None, side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None, progress: Progress | None = None,
    ) -> NDArray[np.int32]:  # fmt: skip
        """Return (...,) int32: the face that `closest_hit` finds, -1 on a miss.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     tracer.closest_prim([[0.1, 0.2, 5], [3, 3, 5]], [0, 0, -1])
        array([151,  -1], dtype=int32)
        """
        hits = self.closest_hit(
            origins, directions, t_min=t_min, t_max=t_max, mask=mask, side=side, exclude=exclude, progress=progress
        )
        return hits.prim_id

    def any_hit(
        self, origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, *, t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf, mask: ArrayLike | None = None, side: str | None = None,
        exclude: ArrayLike | Hits | ClosestPoints | None = None, progress: Progress | None = None,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Return (...,) bool: whether each ray hits anything. Errors are those of `closest_hit`.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     tracer.any_hit([[0.1, 0.2, 5], [3, 3, 5]], [0, 0, -1])
        array([ True, False])
        """
        counts = self.count_hits(
            origins,
            directions,
            t_min=t_min,
            t_max=t_max,
            max_hits=1,
            mask=mask,
            side=side,
            exclude=exclude,
            progress=progress,
        )
        return np.asarray(counts > 0)

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
        """Return (...,) int32: the number of hits of each ray, `max_hits` at most; see `Tracer.count_hits`.

        Errors are those of `closest_hit`.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     tracer.count_hits([[0.1, 0.2, 5], [3, 3, 5]], [0, 0, -1])
        array([2, 0], dtype=int32)
        """
        limit = check_max_hits(max_hits)
        batch = _read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        counts, most = np.zeros(batch.ray_count, np.int32), limit or NO_LIMIT
        limits = np.full(batch.ray_count, np.inf, np.float32)

        def count(caster: Caster, prim_ids: NDArray[np.int32], part: RayBatch, rays: NDArray[np.int64]) -> None:
            found = count_hits(caster, part, limit, None)
            counts[rays] += np.minimum(found, most - counts[rays])
            limits[rays[counts[rays] == most]] = -np.inf

        self._visit(batch, partial(_compare_rays, self._session), limits, count, progress)
        return counts.reshape(batch.shape)

    def all_hits(
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
    ) -> AllHits:
        """Return all hits, grouped by ray and sorted by t, at most `max_hits` of each; see `Tracer.all_hits`.

        Errors are those of `closest_hit`.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     tracer.all_hits([[0.1, 0.2, 5], [3, 3, 5]], [0, 0, -1]).t.round(2)
        array([4.03, 5.97])
        """
        limit = check_max_hits(max_hits)
        batch = _read_rays(origins, directions, t_min, t_max, mask, side, exclude)
        limits = np.full(batch.ray_count, np.inf, np.float32)
        parts = [(np.empty(0, np.int64), np.empty(0, np.float32), RefinedHits.make(0))]
        compare, visit = partial(_compare_rays, self._session), partial(_cross, limit=limit, parts=parts)
        self._visit(batch, compare, limits, visit, progress)
        rays, device_t = (np.concatenate([part[lane] for part in parts]) for lane in range(2))
        hits = RefinedHits(*map(np.concatenate, zip(*(found for _, _, found in parts), strict=True)))
        # In the order of the device, in which equal t are in the order of the faces.
        order = np.lexsort((hits.prim_id, device_t, rays))
        counts = np.bincount(rays, minlength=batch.ray_count)
        if limit is not None:
            rank = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
            order, counts = order[rank < limit], np.minimum(counts, limit)
        t, u, v, is_front, prim_id, instance_id = hits
        hits = RefinedHits(t[order], u[order], v[order], is_front[order], prim_id[order], instance_id)
        keep_order(counts.astype(np.int32), 0, hits.t)
        of_rays = hits.as_hits(ShardedSurface(self.shards))
        return AllHits(**vars(of_rays), offsets=running_sums(counts))

    def closest_point(
        self, points: ArrayLike, *, mask: ArrayLike | None = None, max_distance: ArrayLike = np.inf,
        progress: Progress | None = None,
    ) -> ClosestPoints:  # fmt: skip
        """Return the closest point of the surface for each point; see `Tracer.closest_point`.

        Errors are those of `closest_hit`.

        Examples
        --------
        >>> import clbvh
        >>> _ = clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=300)
        >>> with clbvh.ShardedTracer("parts") as tracer:
        ...     tracer.closest_point([[0, 0, 5], [0, 3, 0]]).distance.round(2)
        array([4., 2.])
        """
        seen = SeenPoints.read(points, mask, max_distance=max_distance)
        count = seen.count
        check_room(count, POINT_BYTES, "points")
        found = FoundPoints.make(count)
        found.drop(np.ones(count, np.bool_))
        squares = np.full(count, np.inf, np.float32)
        visit = partial(_find_nearer, squares=squares, found=found)
        self._visit(seen.rows, _compare_points, squares, visit, progress)
        # Every other mask sees a mesh.
        found.drop(np.broadcast_to(seen.masks == 0, seen.shape).reshape(-1))
        found.drop_beyond(seen.limits, seen.shape)
        return found.as_closest(seen.shape, ShardedSurface(self.shards))

    def _visit(
        self, items: Any, compare: Callable[..., None], limits: NDArray[np.float32], visit: Callable[..., object],
        progress: Progress | None,
    ) -> None:  # fmt: skip
        """Call a function with each shard that some of the rays or points may meet, with those, and their indices.

        Parameters
        ----------
        items : RayBatch, or Broadcast of points
        compare : function
            Writes which boxes some of the items may meet before their limits: `_compare_rays` or `_compare_points`.
        limits : (n,) float32
            As the device has them; may become less with every visit.
        visit : function
            Called with the shard's `Caster`, its faces' numbers in the whole mesh, the items and their indices.
        progress : function, optional
            Of the user.
        """
        with self._lock:
            if self._session.is_closed:
                raise QueryError("the tracer is closed: its shards are no longer there")
            bits, order = self._compare(items, compare, self._boxes, limits)
            for visited, number in enumerate(order):
                if progress is not None and visited:
                    progress(len(limits) * visited // len(order), len(limits))
                opened, box = self._open(number), self._boxes[number : number + 1]
                ids = np.flatnonzero(bits[:, number >> 3] & (1 << (number & 7)))
                for begin in range(0, len(ids), CHUNK_RAYS):
                    # Of these, only those that no shard before has answered.
                    chosen = ids[begin : begin + CHUNK_RAYS]
                    is_near, _ = self._compare(items.take(chosen), compare, box, limits[chosen])
                    chosen = chosen[is_near[:, 0] > 0]
                    if len(chosen):
                        visit(opened.caster, opened.prim_ids, _take(items, chosen, opened.prim_ids), chosen)
            if progress is not None:
                progress(len(limits), len(limits))

    def _compare(
        self, items: Any, compare: Callable[..., None], boxes: NDArray[np.float32], limits: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], list[int]]:
        """Return the boxes that rays or points may meet, as bits, and the order of these boxes by mean distance."""
        bits = np.zeros((len(limits), -(-len(boxes) // 8)), np.uint8)
        begins = range(0, len(limits), _COMPARED_ITEMS)
        sums = np.zeros((len(begins), len(boxes), 2))

        def compare_ranges(first: int, last: int) -> None:
            for index in range(first, last):
                begin, end = begins[index], min(begins[index] + _COMPARED_ITEMS, len(limits))
                compare(self._box, items, begin, end, boxes, limits[begin:end], bits[begin:end], sums[index])

        self._session.threads.for_ranges(len(begins), compare_ranges, least_items=1)
        distances, counts = sums.sum(axis=0).T
        order = np.argsort(distances / np.maximum(counts, 1), kind="stable").tolist()
        return bits, [number for number in order if counts[number] > 0]

    def _open(self, number: int) -> _Opened:
        """Return a shard in memory, after the one before has left it."""
        if self._opened is not None and self._opened.number == number:
            return self._opened
        self._release()
        mesh, prim_ids = self.shards[number].load()
        session = self._session.branch()
        try:
            state = Scene(mesh).snapshot()
            world = open_world(session, state, [self._plan_tree(number, mesh)], self._layout)
        except BaseException:
            session.close()
            raise
        self._opened = _Opened(number, prim_ids, Caster(session, replace(world, box=self._box)))
        return self._opened

    def _plan_tree(self, number: int, mesh: Mesh) -> Bvh | BuildOptions:
        """Return the tree of a shard that is kept beside it; or build it, and keep it."""
        from ..builders.build import plan_tree
        from ..builders.tree_cache import take_tree
        from ..bvh import Bvh

        path = self.shards[number].path.with_suffix(f".{self._quality}.tree")
        kept, _ = take_tree(path, mesh)
        if kept is not None:
            return kept
        plan = plan_tree(mesh, self._quality)
        if isinstance(plan, Bvh):
            with suppress(OSError, ConfigError):  # of a folder that cannot be written to
                plan.save(path)
        return plan

    def _release(self) -> None:
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.caster.close()
            # Events that nobody has read keep the buffers of their commands: 25 MB of each shard of 400,000 triangles.
            self._session.times.sums_ms()


class ShardedSurface(Surface):
    """The surface of a mesh in shards, which are loaded for each question: where hits are, and their normals."""

    def __init__(self, shards: tuple[Shard, ...]) -> None:
        for name, value in (("_shards", shards), ("names", ()), ("arrays", make_surface_arrays((), _NO_IDS, None))):
            object.__setattr__(self, name, value)

    @property
    def shapes(self) -> Any:
        """Raise `ConfigError`: no shape is in memory."""
        raise ConfigError(
            "hits of shards do not know the whole mesh: ask a clbvh.Tracer of it, or take prim_id, u and v"
        )

    @property
    def lone_mesh(self) -> None:
        """None: it is not in memory."""
        return None

    def _for_points(
        self, compute: Callable[..., None], points: SurfacePoints, *more: NDArray[Any],
        into: NDArray[Any] | None = None, prepare: Callable[..., None] | None = None,
    ) -> NDArray[Any]:  # fmt: skip
        shape = points.prim_id.shape
        vectors = np.full((*shape, 3), np.nan) if into is None else into
        flat = vectors.reshape(-1, 3) if into is None else into
        prims, instances, us, vs = points.flat()
        others = [np.reshape(values, (len(prims), *values.shape[len(shape) :])) for values in more]
        for shard in self._shards:  # type: ignore[attr-defined]
            mesh, prim_ids = shard.load()
            faces = np.minimum(np.searchsorted(prim_ids, prims), len(prim_ids) - 1).astype(np.int32)
            own = np.flatnonzero(prim_ids[faces] == prims)
            if len(own):
                on_shard = SurfacePoints(faces[own], instances[own], us[own], vs[own])
                own_flat = None if into is None else np.empty(len(own), into.dtype)
                flat[own] = Surface.of_mesh(mesh)._for_points(
                    compute, on_shard, *(values[own] for values in others), into=own_flat, prepare=prepare
                )
        return vectors


_NO_IDS = np.empty(0, np.int32)


def _read_rays(
    origins: ArrayLike | Hits | ClosestPoints, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike,
    mask: ArrayLike | None, side: str | None, exclude: ArrayLike | Hits | ClosestPoints | None,
) -> RayBatch:  # fmt: skip
    batch = read_unmasked_rays(find_origins(origins, directions), directions, t_min, t_max, mask)
    return batch.limit_sight(side, exclude, is_lone=True)


def _take(items: Any, ids: NDArray[np.int64], prim_ids: NDArray[np.int32]) -> Any:
    """Return some of the rays or points; the faces that rays do not see, by their numbers in a shard."""
    taken = items.take(ids)
    excluded = getattr(taken, "excluded", None)
    if excluded is not None:
        own = np.minimum(np.searchsorted(prim_ids, excluded["prim_id"]), len(prim_ids) - 1)
        excluded["prim_id"] = np.where(prim_ids[own] == excluded["prim_id"], own, NO_PRIM)
    return taken


def _compare_rays(
    session: DeviceSession, box: TreeBox, batch: RayBatch, begin: int, end: int, boxes: NDArray[np.float32],
    limits: NDArray[np.float32], bits: NDArray[np.uint8], sums: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write which boxes rays may meet, a bit for each; and add up where they enter them, and how many do."""
    packed, entries = np.empty(end - begin, PACKED_RAY), np.empty((end - begin, len(boxes)), np.float32)
    pack_rays(batch, box, packed, first_ray=begin)
    np.minimum(packed["t_max"], limits, out=packed["t_max"])
    with session.branch() as own:
        written = own.allocate(entries.nbytes)
        own.run(
            own.kernel("meet_boxes"), (len(packed),), (own.settings.work_group_size,), rays=own.upload(packed),
            ray_count=np.int32(len(packed)), boxes=own.upload(boxes), box_count=np.int32(len(boxes)), entries=written,
        )  # fmt: skip
        own.download(written, entries)
    is_met = entries < np.inf
    bits[:] = np.packbits(is_met, axis=1, bitorder="little")
    sums[:, 0], sums[:, 1] = np.where(is_met, entries, 0.0).sum(axis=0), is_met.sum(axis=0)


def _compare_points(
    box: TreeBox, points: Broadcast, begin: int, end: int, boxes: NDArray[np.float32], limits: NDArray[np.float32],
    bits: NDArray[np.uint8], sums: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write which boxes may have the closest triangle of points, as `_compare_rays`; limits are squared distances."""
    # As the device sees the points, see `pack_points`.
    local = (take_points(points, begin, end, box) - box.centre) * box.scale
    far, size = FAR_POINT_SHARE * box.half.max(), np.abs(local).max(axis=1, initial=0.0, keepdims=True)
    local = np.where(size > far, local * (far / np.maximum(size, _LEAST_SIZE)), local)[:, None]
    lower, upper = boxes.transpose(1, 0, 2).astype(np.float64)
    nearest = np.linalg.norm(np.maximum(np.maximum(lower - local, local - upper), 0.0), axis=2)
    # A box has a triangle, unless it is empty, and that is no farther than the box's farthest corner.
    farthest = np.linalg.norm(np.maximum(np.abs(local - lower), np.abs(local - upper)), axis=2).min(axis=1)
    slack = _POINT_SLACK * (np.abs(local).sum(axis=2) + 3.0)
    is_near = nearest <= np.minimum(np.sqrt(limits, dtype=np.float64), farthest)[:, None] + slack
    for number in range(len(boxes)):
        bits[:, number >> 3] |= is_near[:, number].astype(np.uint8) << (number & 7)
    sums[:, 0], sums[:, 1] = np.where(is_near, nearest, 0.0).sum(axis=0), is_near.sum(axis=0)


def _cast_closest(
    caster: Caster, prim_ids: NDArray[np.int32], batch: RayBatch, rays: NDArray[np.int64], *,
    device_t: NDArray[np.float32], hits: RefinedHits,
) -> None:  # fmt: skip
    """Replace the hits of rays, the batch, by nearer ones in a shard; `rays` are their indices in the answers."""

    def find(part: Rays) -> None:
        with part.find(CLOSEST_HIT) as found:
            own = rays[part.piece.begin : part.piece.begin + len(found)]
            is_nearer = _keep_nearer(found, own, prim_ids, device_t, hits.prim_id)
            refine = partial(_refine, caster, batch, part.piece.begin, found, own, is_nearer, hits)
            caster.threads.for_ranges(len(found), refine, least_items=LEAST_HITS)

    cast_rays(caster, batch, find)


def _keep_nearer(
    found: NDArray[np.void], rays: NDArray[np.int64], prim_ids: NDArray[np.int32], device_t: NDArray[np.float32],
    prims: NDArray[np.int32],
) -> NDArray[np.bool_]:  # fmt: skip
    """Keep the hits that come before the rays' earlier ones, by t and then by face; return (n,) bool: which."""
    t, faces = found["t"], prim_ids[found["prim_id"]]
    is_nearer = (t < device_t[rays]) | ((t == device_t[rays]) & (faces < prims[rays]))
    is_nearer &= found["prim_id"] != NO_PRIM
    device_t[rays[is_nearer]], prims[rays[is_nearer]] = t[is_nearer], faces[is_nearer]
    return is_nearer


def _refine(
    caster: Caster, batch: RayBatch, piece_begin: int, found: NDArray[np.void], rays: NDArray[np.int64],
    is_nearer: NDArray[np.bool_], hits: RefinedHits, begin: int, end: int,
) -> None:  # fmt: skip
    """Write some of the hits of a piece in float64, those that are nearer."""
    kept, own, nearer = found[begin:end].copy(), RefinedHits.make(end - begin), is_nearer[begin:end]
    kept["prim_id"][~nearer] = NO_PRIM
    refine_closest(batch, piece_begin + begin, caster.world.arrays, kept, own)
    for values, found_values in zip(hits[:4], own[:4], strict=True):
        values[rays[begin:end][nearer]] = found_values[nearer]


def _cross(
    caster: Caster, prim_ids: NDArray[np.int32], batch: RayBatch, rays: NDArray[np.int64], *, limit: int | None,
    parts: list[_Crossed],
) -> None:  # fmt: skip
    """Add the crossings of rays with a shard to the parts; `rays` are their indices in the answers."""
    crossings = find_crossings(caster, batch, limit, None)
    counts, offsets = crossings.counts, running_sums(crossings.counts)
    refined = RefinedHits.make(int(offsets[-1]))

    def refine(begin: int, end: int) -> None:
        refine_rays(batch, caster.world.arrays, crossings, begin, end, int(offsets[begin]), refined, None)

    caster.threads.for_ranges(len(rays), refine, least_items=LEAST_HITS)
    firsts = crossings.segment_begins[crossings.sources >> OFFSET_BITS] + (crossings.sources & OFFSET_MASK)
    rows = np.repeat(firsts - offsets[:-1], counts) + np.arange(offsets[-1])
    hits = refined._replace(prim_id=prim_ids[refined.prim_id])
    parts.append((np.repeat(rays, counts), crossings.found["t"][rows], hits))


def _find_nearer(
    caster: Caster, prim_ids: NDArray[np.int32], points: Broadcast, ids: NDArray[np.int64], *,
    squares: NDArray[np.float32], found: FoundPoints,
) -> None:  # fmt: skip
    """Replace the closest points by nearer ones in a shard; `ids` are the indices of the points in the answers."""
    world, rows = caster.world, take_points(points, 0, len(ids), caster.world.box)

    def find(part: Points) -> None:
        own = ids[part.piece.begin : part.piece.end]
        hits = part.find_hits(_CLOSEST_IN_SHARD)
        nearer = np.flatnonzero(_keep_nearer(hits, own, prim_ids, squares, found.prim_id)).astype(np.int32)
        kept, slots = FoundPoints.make(len(nearer)), np.arange(len(nearer), dtype=np.int32)
        here = rows[part.piece.begin : part.piece.end]
        refine_points(here, world.arrays, world.metrics.metrics, world.box, nearer, hits[nearer], kept, slots)
        targets = own[nearer]
        values: Any
        for values, found_values in zip(found, kept._replace(prim_id=found.prim_id[targets]), strict=True):
            values[targets] = found_values

    look_up(caster, SeenPoints(rows), find)

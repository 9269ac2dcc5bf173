"""A launch: rays or points are packed into a batch on the device, the batch is cast with a kernel, results come back.

A query opens a call. The call packs batches and casts them; its queue and its buffers belong to it alone until it ends,
and then serve the next call. Nothing else is remembered from one call to the next, so calls of several threads do not
know of each other.
"""

from __future__ import annotations

import functools
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from copy import copy
from functools import partial
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..device.context import Kernel
from ..device.program import build_kernel
from ..device.session import DeviceSession, ReusableBuffer
from ..errors import DeviceMemoryError
from ..structs import HIT, PACKED_POINT, PACKED_RAY, RAY_LOW, SCENE_POINT
from ..support.context_manager import ContextManager
from ..support.host_threads import HostThreads
from .host.walk import cast_on_host, count_steps
from .rays.batch import RayBatch, TreeBox
from .rays.pack import find_shared_low, pack_rays
from .rays.pieces import CHUNK_RAYS, MOST_SAMPLED_BYTES, Progress, RayPiece, StepCounter, cut_points, cut_rays
from .running_calls import MemoryLoan, RunningCalls
from .traced_tree import ENTRY_POINT_KERNEL, TracedTree, WideArrays, find_entry_points

_Rest = ParamSpec("_Rest")
_Result = TypeVar("_Result")


class Query(NamedTuple):
    """A kernel and what it writes.

    Attributes
    ----------
    kernel : str
        Name of the kernel and of its file.
    results : str
        Name of the argument for the results.
    dtype : numpy.dtype
        Of one result.
    """

    kernel: str
    results: str
    dtype: np.dtype

    def over(self, tree: TracedTree) -> Query:
        """Return the query as the kernels for a tree or a scene answer it."""
        kernel = f"scene_{self.kernel}" if tree.has_instances and "hit" not in self.kernel else self.kernel
        return Query(kernel, self.results, tree.hit_dtype if self.dtype == HIT else self.dtype)


CLOSEST_HIT = Query("closest_hit", "hits", HIT)
ANY_HIT = Query("any_hit", "blocked", np.dtype(np.uint8))
COUNT_HITS = Query("count_hits", "counts", np.dtype(np.int32))
FIRST_HITS = Query("first_hits", "hits", HIT)
CLOSEST_POINT = Query("closest_point", "prim_ids", np.dtype(np.int32))

# A batch that does not fit the device is cut into halves again and again, down to 1,024 of `CHUNK_RAYS`.
MOST_HALVINGS = 10

_MS_PER_S = 1e3

# Up to this many rays are cast by the calling thread, where it sees the device's tree.
MOST_HOST_RAYS = 1024

_device_casts_all: ContextVar[bool] = ContextVar("device_casts_all", default=False)

# "All of them", for a kernel that stops at a number of hits.
NO_LIMIT = np.iinfo(np.int32).max


@contextmanager
def device_casts_all() -> Iterator[None]:
    """Let the device cast all rays that this thread asks for in the block: those who compare devices want no others."""
    before = _device_casts_all.set(True)
    try:
        yield
    finally:
        _device_casts_all.reset(before)


class Batch(NamedTuple):
    """Packed rays or points on the device.

    Attributes
    ----------
    item_count : int
        Rays or points.
    work_size : (int, int)
        Columns and rows of work-items.
    work_group : (int, int)
        Columns and rows of a work-group.
    arguments : mapping of str to argument
        What a kernel is told about the batch, by the names of its arguments.
    """

    item_count: int
    work_size: tuple[int, int]
    work_group: tuple[int, int]
    arguments: Mapping[str, Any]


class Caster(ContextManager):
    """One tree on one device, its kernels, and memory for calls; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Closed with the caster.
    tree : DeviceTree or DeviceScene
    box : TreeBox
        Around the tree.
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, box: TreeBox) -> None:
        self.session = session
        self.tree = tree
        self.box = box
        self.threads = HostThreads()
        self.calls = RunningCalls(session)
        self._kernels: dict[tuple[Any, ...], Kernel] = {}
        self._lock = threading.Lock()
        self.halvings = 0  # of the usual batch, since the device did not hold it
        self._of_rays = self._find_of_rays()

    @property
    def of_rays(self) -> Caster:
        """The caster of rays: this one, unless the tree has another one for rays."""
        return self if self._of_rays is None else self._of_rays

    def over(self, tree: TracedTree, box: TreeBox) -> Caster:
        """Return a caster at another copy of the tree, which shares all else with this one."""
        caster = copy(self)
        caster.tree, caster.box = tree, box
        caster._of_rays = caster._find_of_rays()
        return caster

    def _find_of_rays(self) -> Caster | None:
        """Return a caster at the tree that is for rays alone, if there is one."""
        tree = self.tree.ray_tree
        if tree is None:
            return None
        caster = copy(self)
        caster.tree, caster.box, caster._of_rays = tree, tree.box, None
        return caster

    def open_call(self) -> Call:
        """Return a call to use in a `with` block, which has memory of its own for as long as the block lasts.

        Raises
        ------
        QueryError
            On entering the block: the tree is no longer on the device.
        DeviceError
            On entering the block: this process was forked from one that has used OpenCL.
        """
        return Call(self)

    def cut_smaller(self, tried: int) -> bool:
        """Halve the batches to come, and give back what calls have left; return whether that can help.

        Parameters
        ----------
        tried : int
            Halvings of the batch that the device did not hold. Where another thread has halved since, nothing is.
        """
        with self._lock:
            if tried == MOST_HALVINGS:
                return False
            self.halvings = max(self.halvings, tried + 1)
        self.calls.release_idle()
        return True

    def kernel(self, name: str) -> Kernel:
        """Return a kernel, compiled when first asked for."""
        # The tree of another copy may need a longer stack.
        key = name, *sorted(self.tree.defines.items())
        if key not in self._kernels:
            self._kernels[key] = build_kernel(self.session, name, self.tree.defines)
        return self._kernels[key]

    def close(self) -> None:
        """Give the device's memory back, after the calls of other threads have ended."""
        self.calls.close()
        self.threads.close()

    def release(self) -> None:
        """Give back the memory of calls that have ended; the tree stays."""
        self.threads.close()
        self.calls.release_idle()


class Call(MemoryLoan):
    """One query at work: it packs batches, casts them, and holds its memory until it ends.

    A buffer holds one batch, and one batch's results, at a time: a batch is cast before the next one is packed.
    """

    def __init__(self, caster: Caster) -> None:
        super().__init__(caster.calls)
        self.caster = caster
        self.threads = caster.threads
        self.box = caster.box
        self._tree = caster.tree

    @property
    def hit_dtype(self) -> np.dtype:
        """Of hits on the device."""
        return self._tree.hit_dtype

    def on_host(self, ray_count: int) -> WideArrays | None:
        """Return the tree for `cast_on_host` if the rays are so few that the host casts them itself, or else None."""
        if not 0 < ray_count <= MOST_HOST_RAYS or _device_casts_all.get():
            return None
        return self._tree.on_host()

    def fit(self, dtype: np.dtype, wanted: int) -> int:
        """Return how many items of a dtype the device holds in one buffer, `wanted` at most; see `cut_smaller`."""
        return self._session.fit_items(dtype.itemsize, max(1, wanted >> self.caster.halvings))

    def cut_rays(
        self,
        batch: RayBatch,
        shape: tuple[int, ...] = (),
        *,
        most_rays: int = 0,
        progress: Progress | None = None,
    ) -> Iterator[RayPiece]:
        """Yield the pieces in which to cast a batch of rays; see `pieces.cut_rays`."""
        return cut_rays(
            batch, self.box, self.threads, shape=shape, tile_rows=self._session.settings.tile[1],
            finds_pictures=self._tree.has_entry_points, chunk_limit=self.fit(PACKED_RAY, CHUNK_RAYS),
            most_rays=most_rays, count_steps=self._step_counter(), progress=progress,
        )  # fmt: skip

    def _step_counter(self) -> StepCounter | None:
        """Return a function that counts the steps of rays, see `pieces.cut_rays`; None for large trees.

        Where the host does not see the tree, as on GPUs, it returns infinity.
        """
        if self._tree.memory_bytes > MOST_SAMPLED_BYTES:
            return None

        def count(batch: RayBatch) -> float:
            tree = self._tree.on_host()
            return math.inf if tree is None else count_steps(tree, self.box, batch)

        return count

    def pack_rays(self, batch: RayBatch, piece: RayPiece, *, in_ray_order: bool = True) -> Batch:
        """Put the rays of a piece on the device.

        Parameters
        ----------
        batch : RayBatch
        piece : RayPiece
            Of the batch.
        in_ray_order : bool
            Whether the results are to be in the order of the chunk's rays, whatever the order of the piece; then the
            piece is the whole chunk.
        """
        count = piece.ray_count
        chunk = None if piece.order is None else batch.part(piece.begin, piece.end)

        def pack(
            first: int,
            last: int,
            packed: NDArray[np.void],
            lows: NDArray[np.void] | None = None,
            shared_low: NDArray[np.void] | None = None,
        ) -> bool:
            if chunk is None or piece.order is None:
                order, begin = None, piece.begin + first
                rays = batch.part(begin, piece.begin + last)
            else:
                order, begin, rays = piece.order[first:last], piece.begin, chunk
            return pack_rays(
                batch, rays, self.box, packed, order=order, first_ray=begin, lows=lows, shared_low=shared_low
            )

        has_instances = self._tree.has_instances
        described: dict[str, Any] = {"ray_count": np.int32(count)}
        if has_instances:
            described |= self._fill_scene_rays(batch, piece, pack)
        else:
            described |= {"rays": self._fill("packed", PACKED_RAY, count, pack), "lows": None, "low_step": np.int32(0)}
        order = None
        if piece.order is not None and in_ray_order:
            order = self._fill("order", piece.order.dtype, count, partial(_copy, piece.order))
        row_length = piece.row_length or count
        work_size, settings = (row_length, -(-count // row_length)), self._session.settings
        work_group = settings.tile if piece.row_length else (settings.work_group_size, 1)
        described["row_length"] = np.int32(row_length)
        starts: dict[str, Any] = {"entry_points": None, "tiles": None}
        if piece.is_coherent and self._tree.has_entry_points:
            starts = find_entry_points(
                self._session, self._tree,
                self.caster.kernel(ENTRY_POINT_KERNEL),
                self._buffer("entry points"), work_size, work_group,
                tile_buffer=self._buffer("tiles") if has_instances else None, **described,
            )  # fmt: skip
        return Batch(count, work_size, work_group, described | {"order": order} | starts)

    def _fill_scene_rays(self, batch: RayBatch, piece: RayPiece, pack: Callable[..., bool]) -> dict[str, Any]:
        """Put the rays of a scene on the device, and their low parts: one for all of them if that is enough."""
        count = piece.ray_count
        shared = find_shared_low(batch, self.box, piece.begin, piece.end, reads_direction=self._tree.advances_rays)
        if shared is not None:
            are_shared: list[bool] = []
            rays = self._fill(
                "packed", PACKED_RAY, count, lambda *part: are_shared.append(pack(*part, shared_low=shared))
            )
            if all(are_shared):
                lows = self._fill("lows", RAY_LOW, 1, partial(_copy, shared))
                return {"rays": rays, "lows": lows, "low_step": np.int32(0)}
        lows = self._buffer("lows").take(count * RAY_LOW.itemsize)
        with self._session.mapped(lows, count, RAY_LOW, write=True) as items:
            rays = self._fill(
                "packed", PACKED_RAY, count,
                lambda first, last, packed: pack(first, last, packed, lows=items[first:last]),
            )  # fmt: skip
        return {"rays": rays, "lows": lows, "low_step": np.int32(1)}

    def cut_points(
        self,
        point_count: int,
        progress: Progress | None = None,
        *,
        dtype: np.dtype | None = None,
        most_points: int = CHUNK_RAYS,
    ) -> Iterator[tuple[int, int]]:
        """Yield the chunks in which to cast points, of a dtype as in `pack_points`; see `pieces.cut_points`."""
        fitting = self.fit(dtype or self._point_dtype, min(most_points, CHUNK_RAYS))
        return cut_points(point_count, most_points=fitting, progress=progress)

    def pack_points(
        self, count: int, pack: Callable[[int, int, NDArray[np.void]], None], *, dtype: np.dtype | None = None
    ) -> Batch:
        """Put points on the device.

        Parameters
        ----------
        count : int
        pack : function
            Called with the begin and end of a range of points, and the (n,) `structs.PACKED_POINT` to write, or
            `structs.SCENE_POINT` for a scene; from several threads.
        dtype : numpy.dtype, optional
            Of packed points, where it is another one.
        """
        points = self._fill("packed", dtype or self._point_dtype, count, pack)
        work_group = (self._session.settings.work_group_size, 1)
        return Batch(count, (count, 1), work_group, {"points": points, "point_count": np.int32(count)})

    @contextmanager
    def cast(
        self, query: Query, batch: Batch, *, results_per_item: int = 1, **arguments: Any
    ) -> Iterator[NDArray[Any]]:
        """Cast a batch with a kernel and give its results, which are valid inside the block.

        Parameters
        ----------
        query : Query
        batch : Batch
            At least one ray or point.
        results_per_item : int
        **arguments
            The kernel's own arguments, by name.
        """
        query, count = query.over(self._tree), batch.item_count * results_per_item
        results = self._buffer("results").take(count * query.dtype.itemsize)
        self._session.run(
            self.caster.kernel(query.kernel), batch.work_size, batch.work_group,
            **self._tree.arguments, **batch.arguments, **{query.results: results}, **arguments,
        )  # fmt: skip
        with self._session.mapped(results, count, query.dtype, write=False) as found:
            yield found

    def cast_on_host(self, tree: WideArrays, query: Query, batch: RayBatch, **arguments: Any) -> NDArray[Any]:
        """Return what the kernel of a query finds for each ray, of a tree from `on_host`; of hits, only `prim_id`."""
        most_crossings = 0 if query is CLOSEST_HIT else int(arguments.get("max_hits", 1))
        return self.run_on_host(cast_on_host, tree, self.box, batch, most_crossings)

    def run_on_host(self, task: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return ``task(*arguments)``, whose time counts as a kernel's: the host does its work."""
        begin = time.perf_counter()
        result = task(*arguments)
        self._session.times.add("kernel", (time.perf_counter() - begin) * _MS_PER_S)
        return result

    @property
    def _point_dtype(self) -> np.dtype:
        return SCENE_POINT if self._tree.has_instances else PACKED_POINT

    @property
    def _session(self) -> DeviceSession:
        return self.memory.session

    def _fill(self, name: str, dtype: np.dtype, count: int, fill: Callable[[int, int, NDArray[Any]], object]) -> Any:
        """Return a buffer of the call after several threads have filled it."""
        buffer = self._buffer(name).take(count * dtype.itemsize)
        with self._session.mapped(buffer, count, dtype, write=True) as items:

            def fill_part(first: int, last: int) -> None:
                fill(first, last, items[first:last])

            self.threads.for_ranges(count, fill_part)
        return buffer

    def _buffer(self, name: str) -> ReusableBuffer:
        return self.memory.buffer(name, for_mapping=name not in ("entry points", "tiles"))


def _copy(source: NDArray[Any], first: int, last: int, target: NDArray[Any]) -> None:
    target[:] = source[first:last]


def cut_smaller_when_full(
    query: Callable[Concatenate[Caster, _Rest], _Result],
) -> Callable[Concatenate[Caster, _Rest], _Result]:
    """Decorate a query that takes a `Caster` first and can begin again: it does so while its pieces can be halved.

    Whether a batch fits is known only when the driver refuses it: other programs use the same memory. The pieces stay
    small for later queries of the caster. The user's progress begins again, too.
    """

    @functools.wraps(query)
    def ask(caster: Caster, /, *arguments: _Rest.args, **named: _Rest.kwargs) -> _Result:
        while True:
            tried = caster.halvings
            try:
                return query(caster, *arguments, **named)
            except DeviceMemoryError:
                if not caster.cut_smaller(tried):
                    raise

    return ask

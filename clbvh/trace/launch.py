"""A call: the memory and the launches of one query.

A query opens a call, puts a batch of rays or points on the device (`rays/`, `points/`), casts it with a kernel, and
reads the results. The call's queue and buffers belong to it alone until it ends, and then serve the next call. Nothing
else is remembered from one call to the next, so calls of several threads do not know of each other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from copy import copy
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import HostKernel
from ..device.radix_sort import sort_pairs
from ..device.session import DeviceSession
from ..errors import DeviceMemoryError, InternalError
from ..support.context_manager import ContextManager
from ..support.forks import make_lock
from .host_items import HostItems
from .running_calls import MemoryLoan, RunningCalls
from .world.changes import Changes
from .world.world import World


class Query(NamedTuple):
    """A kernel and what it writes.

    Attributes
    ----------
    kernel : str
        Name of the kernel and of its file.
    results : str
        Name of the argument for the results.
    dtype : numpy.dtype or None
        Of one result; None: hits, see `World.hit_dtype`.
    more_here : int
        Further arrays that the host's kernel takes, and that are left out.
    """

    kernel: str
    results: str
    dtype: np.dtype | None = None
    more_here: int = 0


# A batch that does not fit the device is cut into halves again and again, down to 1,024 of `CHUNK_RAYS`.
MOST_HALVINGS = 10

# Of the numbers by which rays and points are ordered.
_KEY_BITS = 25

# Least items of a thread's range in a buffer. Packing a ray takes 9 ns, and waking a thread as long as 6,000 of them.
_LEAST_FILLED = 1 << 13


class Batch(NamedTuple):
    """Rays or points on the device.

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
    arrays : mapping of str to argument
        The same of rays in arrays on the device, see cl/rays/arrays.cl; empty of any other batch.
    here : HostItems or None
        Rays that the host casts where they are, instead of what stands above.
    """

    item_count: int
    work_size: tuple[int, int]
    work_group: tuple[int, int]
    arguments: Mapping[str, Any]
    arrays: Mapping[str, Any] = MappingProxyType({})
    here: HostItems | None = None


class Caster(ContextManager):
    """A world on a device, its kernels, and memory for calls; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Closed with the caster.
    world : World
    owner : str
        Name of the object that the user closes, for messages.
    """

    def __init__(self, session: DeviceSession, world: World, owner: str = "tracer") -> None:
        self.session = session
        self.world = world
        self.threads = session.threads
        self.calls = RunningCalls(session, owner)
        self._kernels: dict[tuple[Any, ...], Any] = {}
        self._lock = make_lock()

    def at(self, world: World) -> Caster:
        """Return a caster at another world, which shares all else with this one."""
        caster = copy(self)
        caster.world = world
        return caster

    def open_call(self) -> Call:
        """Return a call to use in a `with` block, which has memory of its own for as long as the block lasts.

        Raises
        ------
        QueryError
            On entering the block: the world is no longer on the device.
        DeviceError
            On entering the block: this process was forked from one that has used OpenCL.
        """
        return Call(self)

    def run(self, work: Callable[[Call], object]) -> None:
        """Run the work of a query in a call; again, with pieces of half the size, while they do not fit the device.

        Whether a batch fits is known only when the driver refuses it: other programs use the same memory. The pieces
        stay small for later queries of the caster.

        Parameters
        ----------
        work : function
            Called with an open call; it may run more than once, and the user's progress begins again with it.

        Raises
        ------
        QueryError, DeviceError
            As `open_call`.
        DeviceMemoryError
            Even the smallest pieces do not fit.
        """
        fits = False
        while not fits:
            tried = self.calls.halvings
            try:
                with self.open_call() as call:
                    work(call)
                fits = True
            except DeviceMemoryError:
                if not self.cut_smaller(tried):
                    raise

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
            self.calls.halvings = max(self.calls.halvings, tried + 1)
        self.calls.release_idle()
        return True

    def kernel(self, name: str) -> Any:
        """Return a kernel, compiled when first asked for."""
        key = name, *self.world.defines.items()
        if key not in self._kernels:
            self._kernels[key] = self.session.kernel(name, self.world.defines)
        return self._kernels[key]

    def kernel_at(self, world: World, name: str) -> HostKernel:
        """Return a kernel of the host that is told of a world on it."""
        if name not in world.kernels:
            world.kernels[name] = self.kernel(name).with_first(world.arguments)
        return world.kernels[name]

    def run_without_call(self, work: Callable[[Any], object], items: Any) -> None:
        """Run the work of a query with its items on the host, where it needs no memory of a call.

        Raises
        ------
        QueryError
            The world is no longer on the device, or another thread has closed it meanwhile: it waits for calls alone.
        """
        self.calls.check_open()
        try:
            work(items)
        except InternalError:  # of a buffer that was given back
            self.calls.check_open()
            raise

    def close(self) -> None:
        """Give the device's memory back, after the calls of other threads have ended."""
        self.calls.close()

    def release(self) -> None:
        """Give back the memory of calls that have ended; the world stays."""
        self.threads.close()
        self.calls.release_idle()


class HasCaster(ContextManager):
    """A mesh or a scene on a device: what the queries and the moves of a tracer share.

    Attributes
    ----------
    _caster : Caster
        Each query reads it once, because a move replaces it.
    _changes : Changes
        What handles of the scene name, and how its trees follow moves.
    """

    _caster: Caster
    _changes: Changes


def run_pieces(
    caster: Caster, count: int, few: Any, cut: Callable[[Call], Iterable[Any]], work: Callable[[Any], object],
    progress: Callable[[int, int], None] | None,
) -> None:  # fmt: skip
    """Call a function with all rays or points of a query, piece by piece; with few of them at once, without a call.

    Parameters
    ----------
    caster : Caster
    count : int
        Rays or points.
    few : piece or None
        All of them, if they are few and the host takes them where they are.
    cut : function
        Yields the pieces in which a call takes them, and tells the user's progress.
    work : function
        Called with each piece; again with all of them, in smaller pieces, where the device has no room.
    progress : function, optional
        Called with the number of rays or points that are done, and of all.
    """
    if few is None:
        caster.run(lambda call: deque(map(work, cut(call)), 0))
    elif count:
        caster.run_without_call(work, few)
        if progress is not None:
            progress(count, count)
    else:
        caster.calls.check_open()


class Call(MemoryLoan):
    """One query at work: it fills buffers and launches kernels, and holds its memory until it ends.

    A buffer holds one batch, and one batch's results, at a time: a batch is cast before the next one is put there.
    """

    def __init__(self, caster: Caster) -> None:
        super().__init__(caster.calls)
        self.caster, self.world, self.threads = caster, caster.world, caster.threads

    def at(self, world: World) -> Call:
        """Return this call at another world on the same device."""
        call = copy(self)
        call.world = world
        return call

    @property
    def session(self) -> DeviceSession:
        """A branch of the caster's session, for this call."""
        return self.memory.session

    def fit(self, dtype: np.dtype, wanted: int) -> int:
        """Return how many items of a dtype the device holds in one buffer, `wanted` at most; see `cut_smaller`."""
        return self.session.fit_items(dtype.itemsize, max(1, wanted >> self.caster.calls.halvings))

    def take(self, name: str, byte_count: int, *, for_mapping: bool = False) -> Any:
        """Return the call's buffer of a name, with room for some bytes."""
        return self.memory.buffer(name, for_mapping=for_mapping).take(byte_count)

    def fill(self, name: str, dtype: np.dtype, count: int, fill: Callable[[int, int, NDArray[Any]], object]) -> Any:
        """Return the call's buffer of a name after several threads have filled it.

        Parameters
        ----------
        name : str
        dtype : numpy.dtype
        count : int
        fill : function
            Called with the begin and end of a range of items, and the items to write.
        """
        buffer = self.take(name, count * dtype.itemsize, for_mapping=True)
        with self.session.mapped(buffer, count, dtype, write=True) as items:

            def fill_part(begin: int, end: int) -> None:
                fill(begin, end, items[begin:end])

            self.threads.for_ranges(count, fill_part, least_items=_LEAST_FILLED)
        return buffer

    def put(self, name: str, array: NDArray[Any]) -> Any:
        """Return the call's buffer of a name with the items of an array, which are few."""
        buffer = self.take(name, array.nbytes)
        self.session.write(buffer, array)
        return buffer

    def order_by_keys(
        self, count: int, make_keys: Callable[[int, int, NDArray[np.int32]], object]
    ) -> NDArray[np.int32]:
        """Return (count,) int32: the indices of items in the order of their keys, equal ones in their own order.

        Parameters
        ----------
        count : int
        make_keys : function
            ``make_keys(begin, end, keys)`` writes the keys of items begin to end - 1, from 0 to 2^24; called from
            several threads.
        """

        def make_pairs(begin: int, end: int, pairs: NDArray[np.uint64]) -> None:
            keys = np.empty(end - begin, np.int32)
            make_keys(begin, end, keys)
            pairs[:] = keys
            pairs <<= np.uint64(32)
            pairs |= np.arange(begin, end, dtype=np.uint64)

        dtype = np.dtype(np.uint64)
        buffer = self.fill("pairs", dtype, count, make_pairs)
        is_sorted_there = not self.session.info.cuts_loops
        if is_sorted_there:
            buffer = sort_pairs(self.session, buffer, count, _KEY_BITS, take=self.take)
        with self.session.mapped(buffer, count, dtype, write=False) as pairs:
            return (pairs if is_sorted_there else np.sort(pairs)).astype(np.int32)

    def cast(
        self, query: Query, batch: Batch, *, results_per_item: int = 1, **arguments: Any
    ) -> AbstractContextManager[NDArray[Any]]:
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
        dtype, count = query.dtype or self.world.hit_dtype, batch.item_count * results_per_item
        results = self.launch(query, batch, results_per_item=results_per_item, **arguments)
        return self.session.mapped(results, count, dtype, write=False)

    def launch(self, query: Query, batch: Batch, *, results_per_item: int = 1, **arguments: Any) -> Any:
        """Cast a batch as `cast` does, and return the buffer of its results, which the device may still write."""
        dtype, count = query.dtype or self.world.hit_dtype, batch.item_count * results_per_item
        results = self.take("results", count * dtype.itemsize, for_mapping=True)
        session, own = self.session, {**batch.arguments, query.results: results, **arguments}
        if batch.here is not None:
            kernel = self.caster.kernel_at(self.world, query.kernel)
            batch.here.run(session, kernel, [results.array, *[None] * query.more_here], *arguments.values())
        elif session.info.is_host:
            session.run(self.caster.kernel_at(self.world, query.kernel), batch.work_size, batch.work_group, **own)
        else:
            kernel = self.caster.kernel(query.kernel)
            session.run(kernel, batch.work_size, batch.work_group, **self.world.arguments, **own)
        return results

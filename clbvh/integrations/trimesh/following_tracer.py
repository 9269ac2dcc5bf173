"""A tracer that follows something of trimesh, a mesh or a scene, which may change between two queries.

Owns the locks, trying again, and the bound of the device's memory. Meshes are followed by `tracers.py`, scenes by
`scene_tracer.py`. Must not know who queries it.

A mesh of trimesh and its engines refer to each other, so its memory goes back when Python's garbage collector runs,
which counts objects and not their bytes: hence the bound.
"""

from __future__ import annotations

import gc
import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from numbers import Integral
from typing import Any, Generic, NamedTuple, TypeVar
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from ...device.context import check_process, is_inherited
from ...device.info import DeviceInfo
from ...errors import ConfigError, QueryError
from ...geometry import Mesh
from ...trace.tracer import Tracer
from ...trace.world.trees import check_layout

Known = TypeVar("Known")


class EngineOptions(NamedTuple):
    """The options of an engine.

    Attributes
    ----------
    device : DeviceInfo, str, int or None
    layout : str
        Both as `clbvh.Tracer` takes them.
    """

    device: DeviceInfo | str | int | None = None
    layout: str = "auto"


def read_options(device: Any, layout: Any) -> EngineOptions:
    """Return the options of an engine, or raise `ConfigError`; which devices there are is seen by the first query."""
    if not (device is None or isinstance(device, (DeviceInfo, str, Integral))):
        raise ConfigError(f"device must be a clbvh.DeviceInfo, a number, a name or None, not {device!r}")
    check_layout(layout)
    return EngineOptions(int(device) if isinstance(device, Integral) else device, layout)


class FollowingTracer(ABC, Generic[Known]):
    """A tracer that is opened when first needed; `Known` is what is known of the thing that it follows.

    Any number of threads may use one object, as long as none changes the thing meanwhile.

    Parameters
    ----------
    options : EngineOptions

    Attributes
    ----------
    last_use : float
        Seconds on a clock of its own.
    open_tracer : Tracer or None
        The tracer, if there is one now.
    """

    def __init__(self, options: EngineOptions) -> None:
        self.options = options
        self.last_use = 0.0
        self.open_tracer: Tracer | None = None
        self._known: Known | None = None
        self._counted_bytes = 0
        self._lock = threading.RLock()

    @abstractmethod
    def _follow_open(self, thing: Any) -> tuple[Tracer, Known]:
        """Return a tracer of the current mesh or scene, and its known state; the caller holds the lock."""

    def cast(self, thing: Any, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a ray query of the tracer; rays that it refuses hit nothing."""
        return self.ask(thing, lambda tracer, known: cast_any_rays(tracer, query, rays, **more))

    def ask(self, thing: Any, query: Callable[[Tracer, Known], Any]) -> Any:
        """Return `query(tracer, known)`, with a tracer that follows the present state of the mesh or scene."""
        self.last_use = time.monotonic()
        while True:
            check_process()
            with self._lock:
                tracer, known = self._follow_open(thing)
                before, self._counted_bytes = self._counted_bytes, tracer.memory_bytes
                has_grown = before < self._counted_bytes
            if has_grown:
                make_room(self)
            try:
                return query(tracer, known)
            except QueryError:
                # Another thread may have closed it meanwhile: try again with a new one.
                if not tracer.is_closed:
                    raise

    def close(self) -> None:
        """Give the device's and the host's memory back, after the queries of other threads."""
        if not is_inherited():
            with self._lock:
                self._known = None
                self._give_back()

    def give_way(self) -> bool:
        """Give the device's memory back, unless a thread is about to use it; return whether it did."""
        if is_inherited() or not self._lock.acquire(blocking=False):
            return False
        try:
            return self._give_back()
        finally:
            self._lock.release()

    def _open_new(self, source: Any) -> Tracer:
        """Open a tracer with the options, and count its memory anew."""
        device, layout = self.options
        self.open_tracer, self._counted_bytes = Tracer(source, device=device, layout=layout), 0
        return self.open_tracer

    def _give_back(self) -> bool:
        """Close the tracer, and return whether there was one; called under the lock."""
        tracer, self.open_tracer = self.open_tracer, None
        if tracer is not None:
            tracer.close()
        return tracer is not None


# After this many trees have gone to a device, meshes that nobody uses are collected: a collection takes about 50 ms
# with trimesh and what it imports loaded, so it adds less than 1 ms to each tree.
_TREES_PER_COLLECTION = 64

# Trees take this share of a device's memory at most, as far as those in use allow; then the ones that have not been
# used for longest leave it, until half of that is free.
_MEMORY_SHARE = 0.25

_followed: WeakSet[FollowingTracer[Any]] = WeakSet()
_followed_lock = threading.Lock()
_openings = itertools.count(1)


def open_tracers() -> dict[FollowingTracer[Any], Tracer]:
    """Return the tracers that hold memory of a device."""
    with _followed_lock:
        pairs = [(following, following.open_tracer) for following in _followed]
    return {following: tracer for following, tracer in pairs if tracer is not None}


def make_room(newest: FollowingTracer[Any]) -> None:
    """Collect unused meshes from time to time, and remove trees from a device that has too many."""
    with _followed_lock:
        _followed.add(newest)
        is_time = next(_openings) % _TREES_PER_COLLECTION == 0
    opened = newest.open_tracer
    if opened is None:
        return
    device, limit = opened.device, opened.device.memory_bytes * _MEMORY_SHARE
    if is_time or sum(_sizes_on(device).values()) > limit:
        gc.collect()
    sizes = _sizes_on(device)
    held = sum(sizes.values())
    if held > limit:
        for following in sorted(sizes.keys() - {newest}, key=lambda one: one.last_use):
            held -= sizes[following] * following.give_way()
            if held <= limit / 2:
                break


def _sizes_on(device: DeviceInfo) -> dict[FollowingTracer[Any], int]:
    """Return the bytes that each tracer holds on a device."""
    tracers = open_tracers()
    return {following: tracer.memory_bytes for following, tracer in tracers.items() if tracer.device == device}


def cast_any_rays(tracer: Tracer, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
    """Run a query of a tracer; rays that it refuses hit nothing."""
    try:
        return getattr(tracer, query)(*rays, **more)
    except QueryError:
        if rays[0].ndim != 2:
            raise
        origins, directions = (np.array(values, np.float64) for values in rays)
        bad = ~(np.isfinite(origins) & np.isfinite(directions)).all(axis=1) | (directions == 0).all(axis=1)
        if not bad.any():
            raise
        origins[bad], directions[bad] = 0.0, 1.0
        return getattr(tracer, query)(origins, directions, t_max=np.where(bad, -1.0, np.inf), **more)


def has_faces(known: Mesh, mesh: Any) -> bool:
    """Return whether a mesh of trimesh has the faces of the one that was known, and as many vertices."""
    return len(known.vertices) == len(mesh.vertices) and np.array_equal(known.faces, mesh.faces)

"""A tracer that follows something of trimesh, a mesh or a scene, which may change between two queries.

Owns the locks, the device's memory, and trying again. What has changed, and what becomes of it, is known by
`mesh_tracer.py` and `scene_tracer.py`.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from numbers import Integral
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...device.info import DeviceInfo
from ...device.owner_process import check_process, is_inherited
from ...errors import ConfigError, QueryError
from ...trace import Tracer
from ...trace.device_tree import check_layout

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
    on_open : function
        Called with this object, under no lock, after it has taken more of the device's memory.

    Attributes
    ----------
    last_use : float
        Seconds on a clock of its own.
    """

    def __init__(self, options: EngineOptions, on_open: Callable[[Any], None]) -> None:
        self.options = options
        self.last_use = 0.0
        self._on_open = on_open
        self._lock = threading.RLock()
        self._tracer: Tracer | None = None
        self._announced_bytes = 0

    def cast(self, thing: Any, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a ray query of the tracer; rays that it refuses hit nothing."""
        return self._ask(thing, lambda tracer, known: cast_any_rays(tracer, query, rays, **more))

    def close(self) -> None:
        """Give the device's and the host's memory back, after the queries of other threads."""
        if is_inherited():
            return
        with self._lock:
            self._forget()
            tracer = self._take()
        if tracer is not None:
            tracer.close()

    def give_way(self) -> bool:
        """Give the device's memory back, unless a thread is about to use it; return whether it did."""
        if is_inherited() or not self._lock.acquire(blocking=False):
            return False
        try:
            tracer = self._take()
        finally:
            self._lock.release()
        if tracer is not None:
            tracer.close()
        return tracer is not None

    @property
    def open_tracer(self) -> Tracer | None:
        """The tracer, if there is one now."""
        return self._tracer

    @abstractmethod
    def _follow_open(self, thing: Any) -> tuple[Tracer, Known]:
        """Return a tracer of the thing as it is now, and what is known of it; called under the lock."""

    @abstractmethod
    def _forget(self) -> None:
        """Drop what is known of the thing."""

    def _take(self) -> Tracer | None:
        """Return the tracer, which this object no longer has."""
        tracer, self._tracer = self._tracer, None
        return tracer

    def _open_new(self, source: Any) -> Tracer:
        """Open a tracer with the options; its memory is announced anew."""
        device, layout = self.options
        tracer = Tracer(source, device=device, layout=layout)
        self._announced_bytes = 0
        return tracer

    def _ask(self, thing: Any, query: Callable[[Tracer, Known], Any]) -> Any:
        self.last_use = time.monotonic()
        while True:
            tracer, known = self._open(thing)
            try:
                return query(tracer, known)
            except QueryError:
                # Another thread may have closed it meanwhile: try again with a new one.
                if not tracer.is_closed:
                    raise

    def _open(self, thing: Any) -> tuple[Tracer, Known]:
        check_process()
        with self._lock:
            tracer, known = self._follow_open(thing)
            byte_count = tracer.memory_bytes
            has_grown = byte_count > self._announced_bytes
            self._announced_bytes = byte_count
        if has_grown:
            self._on_open(self)
        return tracer, known


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

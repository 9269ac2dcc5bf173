"""The float64 arrays of a world on its device: put there when cl/kernels/refine_hits.cl first needs them.

Vertices and faces stay for the worlds that follow, as long as these have the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...geometry import Mesh
from ...layouts.device_mesh import DeviceMesh
from ...support.forks import make_lock
from .surface_arrays import SurfaceArrays

# Of one shape that lies where its coordinates say; what it has no use for is not read.
_FIRST = np.zeros(1, np.int32)
_LONE = {
    "first_vertex": np.zeros(1, np.int64), "first_face": np.zeros(1, np.int64), "linear": np.zeros((1, 3, 3)),
    "offset": np.zeros((1, 3)), "world_scale": np.ones(1), "is_mirrored": np.zeros(1, np.bool_),
}  # fmt: skip


class RefineBuffers:
    """What the kernel is told of one world; for any number of threads.

    Parameters
    ----------
    find_arrays : function
        See `World`.
    lone : Mesh or None
        The mesh of a lone world. One that is on the device is used as it is.
    before : RefineBuffers, optional
        Of a world that may have some of the same arrays.
    """

    def __init__(
        self, find_arrays: Callable[[], SurfaceArrays], lone: Mesh | None, before: RefineBuffers | None = None
    ) -> None:
        self._find_arrays, self._lone = find_arrays, lone
        self._lock = make_lock()
        self._kept: dict[str, tuple[NDArray[Any], Any]] = {} if before is None else dict(before._kept)
        self._arguments: dict[str, Any] = {}

    @property
    def memory_bytes(self) -> int:
        """Bytes of the buffers."""
        return sum(array.nbytes for array, _ in list(self._kept.values()))

    def on(self, owner: DeviceSession, session: DeviceSession) -> dict[str, Any]:
        """Return the arguments by their names; the owner has the buffers, which its branch for this thread writes."""
        with self._lock:
            if not self._arguments:
                self._arguments = self._put(owner, session)
            return self._arguments

    def _put(self, owner: DeviceSession, session: DeviceSession) -> dict[str, Any]:
        before, self._kept = self._kept, {}
        lone: Any = self._lone
        on_device = {}
        if isinstance(lone, DeviceMesh):
            on_device = {name: lone.buffer_on(session, name) for name in ("vertices", "faces")}
        has_doubles = on_device.get("vertices") is None or lone.has_doubles
        arguments: dict[str, Any] = {"is_lone": np.int32(lone is not None), "has_doubles": np.int32(has_doubles)}
        arguments |= on_device
        source = self._find_arrays() if lone is None else lone
        arrays = {name: getattr(source, name) for name in ("vertices", "faces") if on_device.get(name) is None}
        if lone is None:
            arrays |= {name: getattr(source, name) for name in _LONE} | {"geometry_ids": source.geometry_id}
        else:
            arrays |= _LONE | {"geometry_ids": _FIRST, "world_scale": np.array([lone.scale])}
        for name, array in arrays.items():
            kept = before.get(name)
            if kept is None or kept[0] is not array:
                kept = array, owner.allocate(array.nbytes, writable=False)
                session.write(kept[1], array)
            self._kept[name], arguments[name] = kept, kept[1]
        return arguments

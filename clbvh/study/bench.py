"""The means of a measurement: meshes, worker pools, trees, tracers and engines, opened once and shared by the cases.

A bench lives as long as one group of cases. It owns what must be closed; an experiment only asks for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..builders.processes.pool import SubtreePool
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..geometry import Mesh, load_mesh
from ..geometry.fetch import find_known_mesh
from ..geometry.shapes.make_shape import make_shape
from ..rendering.camera import Camera
from ..rendering.framing import frame_mesh
from ..support.context_manager import ContextManager
from ..support.host_threads import HostThreads, usable_cores
from .case import NotMeasuredError
from .machine import Machine
from .scale import SCANS, Scale

_Thing = TypeVar("_Thing")

# Every procedural mesh of a study is the same each time.
_SEED = 1


class Bench(ContextManager):
    """What one group of cases shares.

    Parameters
    ----------
    scale : Scale
    machine : Machine
    pictures : Path
        Folder for the pictures that samples name.
    """

    def __init__(self, scale: Scale, machine: Machine, pictures: Path) -> None:
        self.scale = scale
        self.machine = machine
        self._pictures = pictures
        self._stack = ExitStack()
        self._things: dict[Hashable, Any] = {}
        self._last_engine: str | None = None

    @property
    def device(self) -> DeviceInfo:
        """The measured OpenCL device.

        Raises
        ------
        NotMeasuredError
            There is none.
        """
        if self.machine.device is None:
            raise NotMeasuredError(self.machine.problem)
        return self.machine.device

    def once(self, key: Hashable, make: Callable[[], _Thing]) -> _Thing:
        """Return what `make` returns, made at the first call with this key."""
        if key not in self._things:
            self._things[key] = make()
        return self._things[key]

    def open(self, key: Hashable, make: Callable[[], _Thing]) -> _Thing:
        """Return like `once` a context manager that is entered, and left with the bench."""
        return self.once(key, lambda: self._stack.enter_context(make()))  # type: ignore[arg-type]

    def mesh(self, name: str) -> Mesh:
        """Return a scan by its name, or a procedural mesh such as ``knot-100000``."""
        return self.once(("mesh", name), lambda: load_named_mesh(name))

    def pool(self, workers: int) -> SubtreePool:
        """Return a pool of this many workers that are ready."""
        pool = self.open(("pool", workers), lambda: SubtreePool(workers))
        pool.wait_ready()
        return pool

    def tree(self, mesh: str, builder: str = "sah") -> Bvh:
        """Return a mesh's tree."""
        return self.once(("tree", mesh, builder), lambda: build(self.mesh(mesh), builder=builder))

    def camera(self, mesh: str, width: int, height: int) -> Camera:
        """Return the camera that sees all of a mesh, as `clbvh render` does."""
        return self.once(("camera", mesh, width, height), lambda: frame_mesh(self.mesh(mesh), aspect=width / height))

    def picture_rays(self, mesh: str, width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the origins and directions of a picture's rays, each (n, 3) float64."""

        def make() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            origins, directions = self.camera(mesh, width, height).rays(width, height)
            return np.ascontiguousarray(origins).reshape(-1, 3), directions.reshape(-1, 3)

        return self.once(("rays", mesh, width, height), make)

    def threads(self, count: int) -> HostThreads:
        """Return threads of this process."""
        return self.open(("threads", count), lambda: HostThreads(count))

    def rest_before(self, engine: str) -> None:
        """Rest for the idle gap if another engine was measured last: its threads may still spin."""
        if self._last_engine not in (None, engine):
            time.sleep(self.scale.idle_gap_s)
        self._last_engine = engine

    def keep_picture(self, name: str, rgb: NDArray[np.uint8]) -> str:
        """Write a picture beside the samples, and return the name of its file."""
        from ..rendering.image_files import write_picture

        self._pictures.mkdir(exist_ok=True)
        file_name = f"{name}.png"
        write_picture(self._pictures / file_name, rgb)
        return file_name

    def close(self) -> None:
        """Close everything. Closing twice is allowed."""
        self._things.clear()
        self._stack.close()


def load_named_mesh(name: str) -> Mesh:
    """Return a mesh by the name that a `Scale` gives it."""
    if name in SCANS:
        return load_mesh(find_known_mesh(name))
    shape, _, triangles = name.rpartition("-")
    return make_shape(shape, triangles=int(triangles), seed=_SEED)


def worker_counts() -> list[int]:
    """Return 1, 2, 4, 8 ... up to the processors of this machine, and their number."""
    cores = usable_cores()
    counts = []
    count = 1
    while count < cores:
        counts.append(count)
        count *= 2
    return [*counts, cores]

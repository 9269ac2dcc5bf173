"""The means of a measurement: meshes, worker pools, trees, pictures and engines, opened once and shared by the cases.

A bench lives as long as one group of cases. It owns what must be closed; an experiment only asks for it.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..builders.options import FAST_QUALITY
from ..builders.processes.pool import SubtreePool
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..files.image_files import write_picture
from ..geometry import Mesh
from ..rendering.options import RenderOptions
from ..rendering.renderer import Renderer
from ..support.host_threads import usable_cores
from ..views.cameras.camera import Camera
from ..views.cameras.framing import frame_mesh
from .machine import Machine
from .samples import NotMeasuredError
from .scale import Scale, load_named_mesh

# The phases of a frame on the device.
FRAME_PHASES = ("upload", "kernel", "download")

# Phases of a build are quantities with this prefix.
PHASE = "phase."

# Linked nodes become an array because a `Bvh` is one; the report's variants of these names did not need that. Copying
# the mesh to the workers' memory counts: threads share it anyway, but processes cannot do without.
_NOT_COUNTED = "convert"

_DIGEST_BYTES = 8

_Thing = TypeVar("_Thing")
Size = tuple[int, int]


@dataclass(frozen=True)
class Frame:
    """A picture and its times.

    Attributes
    ----------
    rgb : (height, width, 3) uint8
    digest : str
        Equal for pictures that are equal bit by bit, hits included.
    times_ms : dict of str to float
        upload, kernel and download, by the device's clock.
    """

    rgb: NDArray[np.uint8]
    digest: str
    times_ms: dict[str, float]


class Bench(ExitStack):
    """What one group of cases shares.

    Sizes of pictures are those of a full study, and become smaller with the scale.

    Parameters
    ----------
    scale : Scale
    machine : Machine
    pictures : Path
        Folder for the pictures that samples name.
    """

    def __init__(self, scale: Scale, machine: Machine, pictures: Path) -> None:
        super().__init__()
        self.scale = scale
        self.machine = machine
        self._pictures = pictures
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

    def open(self, key: Hashable, make: Callable[[], AbstractContextManager[_Thing]]) -> _Thing:
        """Return like `once` a context manager that is entered, and left with the bench."""
        return self.once(key, lambda: self.enter_context(make()))

    def mesh(self, name: str) -> Mesh:
        """Return a scan by its name, or a procedural mesh such as ``knot-100000``."""
        return self.once(("mesh", name), lambda: load_named_mesh(name))

    def pool(self, workers: int) -> SubtreePool:
        """Return a pool of this many workers that are ready."""
        pool = self.open(("pool", workers), lambda: SubtreePool(workers))
        pool.wait_ready()
        return pool

    def build(
        self, mesh: str, builder: str, *, workers: int | None = None, **options: Any
    ) -> tuple[Bvh, dict[str, float]]:
        """Build a tree, by all workers unless told otherwise, or on the device.

        Returns
        -------
        bvh : Bvh
        values : dict of str to float
            ``build_ms``, wall time without the phase "convert", and each phase as ``phase.NAME_ms``.
        """
        if builder == FAST_QUALITY:
            bvh = build(self.mesh(mesh), quality=FAST_QUALITY, device=self.device, **options)
        else:
            bvh = build(self.mesh(mesh), pool=self.pool(workers or usable_cores()), builder=builder, **options)
        phases = {name: float(ms) for name, ms in bvh.timings_ms.items()}
        build_ms = sum(ms for name, ms in phases.items() if name != _NOT_COUNTED)
        return bvh, {"build_ms": build_ms, **{f"{PHASE}{name}_ms": ms for name, ms in phases.items()}}

    def tree(self, mesh: str, builder: str = "sah") -> Bvh:
        """Return a mesh's tree."""
        return self.once(("tree", mesh, builder), lambda: build(self.mesh(mesh), builder=builder))

    def camera(self, mesh: str, size: Size) -> Camera:
        """Return the camera that sees all of a mesh, as `clbvh render` does."""
        width, height = self.scale.picture(*size)
        return self.once(("camera", mesh, size), lambda: frame_mesh(self.mesh(mesh), aspect=width / height))

    def rays(self, mesh: str, size: Size) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the origins and directions of a picture's rays, each (n, 3) float64."""

        def make() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            origins, directions = self.camera(mesh, size).rays(*self.scale.picture(*size))
            return np.ascontiguousarray(origins).reshape(-1, 3), directions.reshape(-1, 3)

        return self.once(("rays", mesh, size), make)

    def draw(self, mesh: str, bvh: Bvh, size: Size, *, layout: str = "auto", shading: str = "lambert") -> Frame:
        """Upload a tree, draw one picture with it, and take everything off the device again."""
        width, height = self.scale.picture(*size)
        with Renderer(bvh, options=RenderOptions(device=self.device, layout=layout)) as renderer:
            picture = renderer.render(camera=self.camera(mesh, size), shading=shading, width=width, height=height)
        digest = hashlib.blake2b(picture.rgb.tobytes() + picture.found.tobytes(), digest_size=_DIGEST_BYTES)
        times_ms = {phase: renderer.timings[phase] + picture.timings[phase] for phase in FRAME_PHASES}
        return Frame(picture.rgb, digest.hexdigest(), times_ms)

    def keep_picture(self, name: str, rgb: NDArray[np.uint8]) -> str:
        """Write a picture beside the samples, and return the name of its file."""
        self._pictures.mkdir(exist_ok=True)
        write_picture(self._pictures / f"{name}.png", rgb)
        return f"{name}.png"

    def rest_before(self, engine: str) -> None:
        """Rest for the idle gap if another engine was measured last: its threads may still spin."""
        if self._last_engine not in (None, engine):
            time.sleep(self.scale.idle_gap_s)
        self._last_engine = engine

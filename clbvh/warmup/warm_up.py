"""Runs the steps of a warm-up, and counts the functions and kernels that each of them compiles.

There is no list of functions: each step does real work, so functions are compiled for the types of real calls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import DTypeLike

from ..builders.build import build
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.settings import find_settings
from ..structs import LAYOUT_WIDTHS
from ..support.stopwatch import Stopwatch
from ..trace.device_tree import BRUTE
from .device_work import cast_all, draw, use_scene, use_trimesh
from .host_work import list_host_work, make_mesh

HOST = "host"

Work = tuple[str, Callable[[], object]]


@dataclass(frozen=True)
class WarmStep:
    """One step of a warm-up.

    Attributes
    ----------
    where : str
        ``"host"``, or the name of a device.
    what : str
        Name of the work.
    compiled, loaded : int
        Functions and kernels that the step compiled, and that it found in a cache.
    compile_ms, total_ms : float
        Time for compiling, and wall time.
    """

    where: str
    what: str
    compiled: int
    loaded: int
    compile_ms: float
    total_ms: float


def warm_up(devices: Sequence[DeviceInfo], *, quick: bool = False) -> Iterator[WarmStep]:
    """Compile everything that is not compiled yet, step by step.

    Parameters
    ----------
    devices : sequence of DeviceInfo
    quick : bool
        Leave out the report's builders, the reference of `--validate`, and all layouts but the device's own, which few
        programs need.

    Yields
    ------
    WarmStep
        After each step.

    Raises
    ------
    DeviceError, KernelBuildError
        A device or its driver fails.
    """
    for what, work in list_host_work(quick=quick):
        yield _measure(HOST, what, work)
    for number, device in enumerate(devices):
        for what, work in _list_device_work(device, is_first=number == 0, quick=quick):
            yield _measure(device.name, what, work)


def _measure(where: str, what: str, work: Callable[[], object]) -> WarmStep:
    watch = Stopwatch()
    work()
    code, total_ms = watch.code, watch.total_ms
    return WarmStep(where, what, code.compiled_count, code.loaded_count, code.compile_ms, total_ms)


def _list_device_work(device: DeviceInfo, *, is_first: bool, quick: bool) -> Iterator[Work]:
    """Yield names and work; work for host functions only with the first device, because all devices share them."""
    own = find_settings(device).layout
    layouts = (own,) if quick else (own, *(layout for layout in LAYOUT_WIDTHS if layout != own))
    for layout in layouts:
        yield f"pictures, {layout}", partial(draw, device, layout)
        yield f"queries, {layout}", partial(_cast, device, layout, np.float64)
    if is_first:
        yield "queries, float32", partial(_cast, device, own, np.float32)
        yield "queries of trimesh", partial(use_trimesh, device)
    if quick:
        return
    # Other layouts of scenes are compiled when they are asked for: they would take as long as all the rest.
    yield "scenes of meshes", partial(use_scene, device, own, has_spheres=False)
    yield "scenes with spheres", partial(use_scene, device, own, has_spheres=True)
    yield "validation", partial(draw, device, own, validate=True)
    yield "pictures without a tree", partial(draw, device, own, builder=BRUTE)


def _cast(device: DeviceInfo, layout: str, dtype: DTypeLike) -> None:
    cast_all(_tree(), device, layout, dtype)


@cache
def _tree() -> Bvh:
    return build(make_mesh())

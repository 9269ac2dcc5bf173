"""The order of a warm-up, and what each step of it compiled.

Owns no list of functions: a step does work that needs them, so that they are compiled for the types that they are
called with.
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
from .device_work import cast_all, draw
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
    compiled, loaded : int
        Functions and kernels that were compiled, and that had been before.
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
    """Compile what is not compiled yet, step by step.

    Parameters
    ----------
    devices : sequence of DeviceInfo
    quick : bool
        Only what most programs need: without the report's builders, the reference of `--validate`, and the layouts
        that are not the device's own.

    Yields
    ------
    WarmStep
        After each step.

    Raises
    ------
    DeviceError, KernelBuildError
        A device cannot do it.
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
    """Yield names and functions; the functions of the host are the same for all devices, so the first one's will do."""
    own = find_settings(device).layout
    layouts = (own,) if quick else (own, *(layout for layout in LAYOUT_WIDTHS if layout != own))
    for layout in layouts:
        yield f"pictures, {layout}", partial(draw, device, layout)
        yield f"queries, {layout}", partial(_cast, device, layout, np.float64)
    if is_first:
        yield "queries, float32", partial(_cast, device, own, np.float32)
    if quick:
        return
    if is_first:
        for dtype in (np.float32, np.float64):
            yield f"queries, {np.dtype(dtype)}, read-only", partial(_cast, device, own, dtype, writable=False)
    yield "validation", partial(draw, device, own, validate=True)
    yield "pictures without a tree", partial(draw, device, own, builder=BRUTE)


def _cast(device: DeviceInfo, layout: str, dtype: DTypeLike, *, writable: bool = True) -> None:
    cast_all(_tree(), device, layout, dtype, writable=writable)


@cache
def _tree() -> Bvh:
    return build(make_mesh())

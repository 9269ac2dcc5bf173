"""The order of the devices, which numbers them and decides which is the default.

Of several drivers for one processor, the fastest by `clbvh tune` comes first. Without its measurements the order is
that of docs/internals/decisions.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from .info import DeviceInfo
from .match import KINDS

# Drivers for the CPU, the fastest first. Others stand between those of the two lists.
_FASTEST_FIRST = ("Portable Computing Language", "Intel(R) OpenCL")
_SLOWEST_LAST = ("Clover", "rusticl")


def number_devices(
    devices: Sequence[DeviceInfo], measured_ms: Callable[[DeviceInfo], float | None] = lambda _: None
) -> tuple[DeviceInfo, ...]:
    """Sort the devices by preference and number them.

    The order of the platforms is the order of files in a folder, which differs between machines and installations; so
    it decides only between devices that are equal in everything else.

    Parameters
    ----------
    devices : sequence of DeviceInfo
    measured_ms : function
        Returns the time that `clbvh tune` kept for a device; None without it.
    """
    ordered = sorted(devices, key=_preference)
    for kind in KINDS:
        _sort_measured(ordered, kind, measured_ms)
    return tuple(replace(device, number=number) for number, device in enumerate(ordered))


def _sort_measured(ordered: list[DeviceInfo], kind: str, measured_ms: Callable[[DeviceInfo], float | None]) -> None:
    """Reorder the measured devices of a kind among their own indices, the fastest first.

    Kinds are not compared: only kernels were timed, without the transfers to a graphics card. A device that was not
    measured keeps its index.
    """
    usable = [index for index, device in enumerate(ordered) if device.kind == kind and _is_usable(device)]
    times = {index: measured_ms(ordered[index]) for index in usable} if len(usable) > 1 else {}
    known = {index: ms for index, ms in times.items() if ms is not None}
    fastest_first = [ordered[index] for index in sorted(known, key=known.__getitem__)]
    for index, device in zip(sorted(known), fastest_first, strict=True):
        ordered[index] = device


def _is_usable(device: DeviceInfo) -> bool:
    return device.is_available and not device.is_emulated


def _preference(device: DeviceInfo) -> tuple[Any, ...]:
    """Return a sorting key, lowest for the preferred device."""
    rank = KINDS.index(device.kind) if device.kind in KINDS else len(KINDS)
    if device.is_emulated:
        rank = len(KINDS)
    is_gpu = device.kind == "gpu"
    return (
        not device.is_available,
        rank,
        # A graphics card before a GPU inside the CPU, which may report all of the host's memory.
        is_gpu and device.has_unified_memory,
        -device.memory_bytes if is_gpu else 0,
        0 if is_gpu else _rank_driver(device.platform),
        device.platform,
        # The newer one of two installed versions of a driver.
        tuple(-int(digits) for digits in re.findall(r"\d+", device.driver_version)),
        device.name,
    )


def _rank_driver(platform: str) -> int:
    if platform in _FASTEST_FIRST:
        return _FASTEST_FIRST.index(platform)
    between = len(_FASTEST_FIRST)
    return between + 1 + _SLOWEST_LAST.index(platform) if platform in _SLOWEST_LAST else between

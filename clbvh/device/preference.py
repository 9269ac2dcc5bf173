"""The order of the devices, and the choice of one: by a number, a kind, a part of a name, or a kind and a part.

The order numbers them and decides which is the default. Of several drivers for one processor, the fastest by `clbvh
tune` comes first; without its measurements, the order is that of docs/devices.md. Names of platforms and devices are
matched apart, because a driver for the CPU puts the processor's brand into the device's name
("cpu-sapphirerapids-Intel(R) Xeon(R)" is PoCL): the maker's name alone means that maker's driver or graphics card.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from ..errors import DeviceError
from .info import DeviceInfo

# The kinds that can be asked for, in the order of preference.
KINDS = ("gpu", "accelerator", "cpu")

# Makers of processors. In the name of a CPU they tell nothing about its driver.
_MAKERS = ("amd", "apple", "arm", "authenticamd", "genuineintel", "intel", "nvidia", "qualcomm")

# Short names of platforms; rusticl's, Oclgrind's, Apple's and Clover's names are short already.
_SHORT_NAMES = {"Portable Computing Language": ("pocl",)}

# Drivers for the CPU, the fastest first; the empty name stands for all others.
_FASTEST_FIRST = ("Portable Computing Language", "Intel(R) OpenCL", "", "Clover", "rusticl")


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
    is_gpu, driver = device.kind == "gpu", device.platform if device.platform in _FASTEST_FIRST else ""
    return (
        not device.is_available,
        KINDS.index(device.kind) if device.kind in KINDS and not device.is_emulated else len(KINDS),
        # A graphics card before a GPU inside the CPU, which may report all of the host's memory.
        is_gpu and device.has_unified_memory,
        -device.memory_bytes if is_gpu else 0,
        0 if is_gpu else _FASTEST_FIRST.index(driver),
        device.platform,
        # The newer one of two installed versions of a driver.
        tuple(-int(digits) for digits in re.findall(r"\d+", device.driver_version)),
        device.name,
    )


def pick_device(devices: Sequence[DeviceInfo], spec: str | int | None, asked_by: str = "") -> DeviceInfo:
    """Return the device that `spec` asks for; the choice behind `choose_device`.

    Parameters
    ----------
    devices : sequence of DeviceInfo
        At least one, in the order of preference, numbered in this order.
    spec : str or int, optional
        As for `choose_device`, without the environment variable.
    asked_by : str
        The origin of `spec`, for error messages.

    Raises
    ------
    DeviceError
        No device matches, or several different ones do.
    """
    if spec is None:
        return devices[0]
    there_are = f"the device{'s are' if len(devices) > 1 else ' is'} " + "; ".join(str(device) for device in devices)

    word = _simplify(str(spec))
    if isinstance(spec, int) or word.isdecimal():
        number = int(word)
        if 0 <= number < len(devices):
            return devices[number]
        # "4090" is not a number of a device here, but may be a part of a name.
        if isinstance(spec, int):
            raise DeviceError(f"there is no device {number}{asked_by}: {there_are}")

    matches = [] if word in KINDS else _match_names(devices, word)
    kinds = [part for part in word.split() if part in KINDS]
    if not matches and len(kinds) == 1:  # "gpu", or with a part of a name, as in "intel gpu"
        of_kind = [device for device in devices if device.kind == kinds[0]]
        name = " ".join(part for part in word.split() if part not in KINDS)
        matches = _match_names(of_kind, name) if name else of_kind
    if not matches:
        hint = f"; '{word}' is only the maker of a processor here, and 'cpu' asks for it" if word in _MAKERS else ""
        hint = hint if any(word in _simplify(device.name) for device in devices) else ""
        raise DeviceError(f"no device matches '{spec}'{asked_by}: {there_are}{hint}")
    # An emulator is asked for by its number or its own name, not by a word that it shares with others.
    matches = [device for device in matches if not device.is_emulated] or matches
    if word not in KINDS and not all(_is_same_hardware(matches[0], other) for other in matches[1:]):
        listed = "; ".join(str(device) for device in matches)
        raise DeviceError(f"'{spec}'{asked_by} matches several devices, give a number or a longer name: {listed}")
    return matches[0]


def _match_names(devices: Sequence[DeviceInfo], word: str) -> list[DeviceInfo]:
    """Return the devices whose own name or platform's name has the word."""
    # A full name beats a part of a longer one: "Tesla T4" must not be ambiguous beside "Tesla T4G".
    exact = [device for device in devices if word in (_simplify(device.name), *_platform_names(device))]
    if exact:
        return exact
    # The maker alone is no part of a CPU's name.
    return [
        device
        for device in devices
        if any(word in name for name in _platform_names(device))
        or (word in _simplify(device.name) and not (word in _MAKERS and device.kind == "cpu"))
    ]


def _platform_names(device: DeviceInfo) -> tuple[str, ...]:
    """Return the names of the driver, without the vendor, which PoCL takes from the CPU ("AuthenticAMD")."""
    return (_simplify(device.platform), *_SHORT_NAMES.get(device.platform, ()))


def _simplify(name: str) -> str:
    """Return a name in lower case, with single blanks, and without the marks of registered names."""
    return " ".join(re.sub(r"\((r|tm)\)", " ", name.lower()).split())


def _is_same_hardware(one: DeviceInfo, other: DeviceInfo) -> bool:
    """Return whether two devices are interchangeable for the user.

    Two drivers for the CPU drive the same CPU; two cards of one name are equally good.
    """
    return one.kind == other.kind and (one.kind == "cpu" or one.name == other.name)

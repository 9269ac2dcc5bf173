"""The devices of this machine: their order, and the choice of one by a number, a kind or a part of a name.

The host is number 0, and the default where there is no GPU; then OpenCL is not even asked. The others are numbered by
preference, see docs/devices.md. Names of platforms and devices are matched apart, because a driver for the CPU
puts the processor's brand into the device's name ("cpu-sapphirerapids-Intel(R) Xeon(R)" is PoCL): the maker's name
alone means that maker's driver or graphics card.

Must not know why a device is missing: that is `doctor.py`. `pyopencl` is imported on first use and may be missing: the
host needs none.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from ..errors import DeviceError, KernelBuildError
from .context import check_process, claim_opencl
from .driver_files import added_drivers, may_serve_gpus, prepare_pocl_folder
from .host.info import describe_host
from .info import HOST_PLATFORM, DeviceInfo

DEVICE_VARIABLE = "CLBVH_DEVICE"

# The kinds that can be asked for, in the order of preference.
KINDS = ("gpu", "accelerator", "cpu")

# Words that mean the host: no driver is asked.
_HOST_WORDS = (HOST_PLATFORM, "cpu", "0")

# Makers of processors. In the name of a CPU they tell nothing about its driver.
_MAKERS = ("amd", "apple", "arm", "authenticamd", "genuineintel", "intel", "nvidia", "qualcomm")

# Short names of platforms; rusticl's, Oclgrind's, Apple's and Clover's names are short already.
_SHORT_NAMES = {"Portable Computing Language": ("pocl",)}

# Drivers for the CPU, the fastest first; the empty name stands for all others.
_FASTEST_FIRST = ("Portable Computing Language", "Intel(R) OpenCL", "", "Clover", "rusticl")

# A note where the host works: see `doctor.py`.
NO_DRIVER = "no OpenCL driver is installed: a GPU needs that of its vendor"

# The error code of an OpenCL loader without a registered driver (extension cl_khr_icd).
_PLATFORM_NOT_FOUND = -1001


@dataclass(frozen=True)
class DeviceSurvey:
    """The answers of all platforms.

    Attributes
    ----------
    devices : tuple of DeviceInfo
        Numbered from 0, the host first.
    problems : tuple of str
        One sentence for each platform or device that was left out, or about OpenCL as a whole.
    """

    devices: tuple[DeviceInfo, ...]
    problems: tuple[str, ...]


def import_pyopencl() -> Any:
    """Import `pyopencl`.

    Raises
    ------
    DeviceError
        It is not installed, or the OpenCL loader that it needs cannot be loaded.
    """
    prepare_pocl_folder()
    try:
        import pyopencl
    except (ImportError, OSError) as error:
        # A copy that pip compiled needs the system's OpenCL loader; wheels bring one.
        again = "" if isinstance(error, ModuleNotFoundError) else "--force-reinstall --only-binary :all: "
        raise DeviceError(
            f"OpenCL needs pyopencl, which cannot be imported ({error}): run `pip install {again}pyopencl`"
        ) from error
    return pyopencl


def survey_devices() -> DeviceSurvey:
    """Describe the host, ask every platform for its devices, and list the failures.

    A platform or a device whose queries fail is left out: one broken driver must not hide the others. A process that
    was forked from one that has used OpenCL has the host alone.
    """
    devices: list[DeviceInfo] = []
    problems: list[str] = []
    for ask in (lambda: [describe_host()], lambda: _ask_platforms(problems)):
        try:
            devices += ask()
        except (DeviceError, KernelBuildError) as error:
            problems.append(str(error))
    return DeviceSurvey(number_devices(devices), tuple(problems))


def _ask_platforms(problems: list[str]) -> list[DeviceInfo]:
    """Return the devices of OpenCL, and add a sentence about each that was left out."""
    cl = import_pyopencl()
    claim_opencl()
    devices: list[DeviceInfo] = []
    try:
        with added_drivers():
            platforms = cl.get_platforms()
    except cl.Error as error:
        is_empty = error.code == _PLATFORM_NOT_FOUND
        problems.append(NO_DRIVER if is_empty else f"the OpenCL loader fails: {error}")
        platforms = []

    for number, platform in enumerate(platforms):
        try:
            platform_name = _tidy(platform.name)
            found = platform.get_devices()
        except cl.Error as error:
            problems.append(f"platform {number} cannot be asked for its devices: {error}")
            continue
        if not found:
            problems.append(f"the platform '{platform_name}' offers no device")
        for cl_device in found:
            try:
                devices.append(_describe(cl, platform, cl_device))
            except cl.Error as error:
                problems.append(f"a device of the platform '{platform_name}' cannot be described: {error}")
    return devices


@cache
def _has_gpus() -> bool:
    """Return whether OpenCL has a device that is preferred to the host; a forked child keeps its parent's answer."""
    if not may_serve_gpus():
        return False
    check_process()
    return any(_is_usable(device) and _rank_kind(device) < KINDS.index("cpu") for device in survey_devices().devices)


def list_devices() -> list[DeviceInfo]:
    """Return all devices, the host first, numbered from 0 in an order that depends on the devices alone.

    Examples
    --------
    >>> import clbvh
    >>> [device.number for device in clbvh.list_devices()][:1]
    [0]
    """
    return list(survey_devices().devices)


def choose_device(spec: Any = None) -> DeviceInfo:
    """Return the device to use.

    Parameters
    ----------
    spec : str, int or pyopencl.Device, optional
        A number of `list_devices`, of which 0 is the host; ``"host"`` or ``"cpu"``, the host as well; ``"gpu"`` or
        ``"accelerator"``; a part of the name of a device or its platform, in upper or lower case, as in ``"pocl"``; or
        both, as in ``"intel gpu"``. The maker of a processor, as in ``"intel"``, means that maker's driver or graphics
        card, not the processor under another driver. Without it the environment variable ``CLBVH_DEVICE`` decides, and
        without that the best device is taken: a GPU, else an accelerator, else the host. A
        `pyopencl.Device` may also be a part of one, as `create_sub_devices` returns them.

    Raises
    ------
    DeviceError
        None matches, or different ones match; or this process was forked from one that has used OpenCL, and the device
        is another one than the host.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.choose_device(0) == clbvh.list_devices()[0]
    True
    >>> clbvh.choose_device(99)
    Traceback (most recent call last):
    clbvh.errors.DeviceError: ...
    """
    asked_by = ""
    if spec is None or spec == "":
        spec = os.environ.get(DEVICE_VARIABLE, "").strip() or None
        asked_by = f" (asked for by {DEVICE_VARIABLE})" if spec is not None else ""
    word = _simplify(str(spec)) if spec is not None else ""
    if word in _HOST_WORDS or (spec is None and not _has_gpus()):
        try:
            return describe_host()
        except (DeviceError, KernelBuildError):
            if word == HOST_PLATFORM:
                raise  # otherwise a driver may serve
    check_process()
    survey = survey_devices()
    if (cl := sys.modules.get("pyopencl")) is not None and isinstance(spec, cl.Device):
        known = next((device for device in survey.devices if device.cl_device == spec), None)
        return known or _describe(cl, spec.platform, spec)
    if not survey.devices:
        reason = f" ({survey.problems[0]})" if survey.problems else ""
        raise DeviceError(f"no device was found{reason}: run `clbvh doctor` to find the cause")
    try:
        return pick_device(survey.devices, spec, asked_by)
    except DeviceError as error:
        if len(survey.devices) > 1 or not survey.problems:
            raise
        # What OpenCL lacks says more than that the host is another one.
        raise DeviceError(f"no device matches '{spec}'{asked_by}: {survey.problems[0]}") from error


def find_again(device: DeviceInfo) -> DeviceInfo:
    """Return a description with its handle, which copies and pickles have lost.

    Raises
    ------
    DeviceError
        This process has no such device.
    """
    if device.is_host:
        return describe_host()
    if device.cl_device is not None:
        return device
    for found in list_devices():
        if found == replace(device, number=found.number):
            return found
    raise DeviceError(f"the device {device.name!r} ({device.platform}) is not here: run `clbvh doctor` for advice")


def _describe(cl: Any, platform: Any, cl_device: Any) -> DeviceInfo:
    """Ask one device for its properties; the number is set later."""

    def ask_if_known(name: str, otherwise: Any) -> Any:
        # Drivers may refuse queries that are newer than they are, or obsolete.
        try:
            return getattr(cl_device, name)
        except (cl.Error, AttributeError):
            return otherwise

    return DeviceInfo(
        number=-1,
        platform=_tidy(platform.name),
        platform_version=_tidy(platform.version),
        name=_tidy(cl_device.name),
        vendor=_tidy(cl_device.vendor),
        version=_tidy(cl_device.version),
        driver_version=_tidy(cl_device.driver_version),
        kind=_name_kind(cl, cl_device.type),
        memory_bytes=int(cl_device.global_mem_size),
        max_allocation_bytes=int(cl_device.max_mem_alloc_size),
        compute_units=int(cl_device.max_compute_units),
        has_fp64=bool(ask_if_known("double_fp_config", 0)),
        has_unified_memory=bool(ask_if_known("host_unified_memory", False)),
        is_available=bool(cl_device.available) and bool(ask_if_known("compiler_available", True)),
        cl_device=cl_device,
    )


def _name_kind(cl: Any, type_bits: int) -> str:
    # The DEFAULT bit may be set besides, so the bits are tested one by one.
    return next((kind for kind in KINDS if type_bits & getattr(cl.device_type, kind.upper())), "other")


def _tidy(text: str) -> str:
    """Return a driver's text on one line, without the padding and the final zero of some drivers."""
    return " ".join(text.replace("\0", " ").split())


def number_devices(devices: Sequence[DeviceInfo]) -> tuple[DeviceInfo, ...]:
    """Sort the devices by preference and number them.

    The order of the platforms is the order of files in a folder, which differs between machines and installations; so
    it decides only between devices that are equal in everything else.
    """
    return tuple(replace(device, number=number) for number, device in enumerate(sorted(devices, key=_preference)))


def _is_usable(device: DeviceInfo) -> bool:
    return device.is_available and not device.is_emulated


def _rank_kind(device: DeviceInfo) -> int:
    return KINDS.index(device.kind) if device.kind in KINDS else len(KINDS)


def _preference(device: DeviceInfo) -> tuple[Any, ...]:
    """Return a sorting key, lowest for the preferred device."""
    is_gpu, driver = device.kind == "gpu", device.platform if device.platform in _FASTEST_FIRST else ""
    return (
        not device.is_host,
        not device.is_available,
        _rank_kind(device) if not device.is_emulated else len(KINDS),
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
        return min(devices, key=lambda device: _rank_kind(device) if _is_usable(device) else len(KINDS))
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

"""Which OpenCL devices there are, and which one to use.

This module asks every platform for its devices and picks one. It must not know why something is missing: that
is `diagnose.py`. `pyopencl` is imported when first needed, so that a machine without a working OpenCL loader gets
a `DeviceError` and not a traceback.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import DeviceError
from .settings import find_settings

DEVICE_VARIABLE = "CLBVH_DEVICE"

# What people ask for by kind, in the order the default prefers them.
KINDS = ("gpu", "accelerator", "cpu")

# What an OpenCL loader answers when no driver is registered (extension cl_khr_icd).
_PLATFORM_NOT_FOUND = -1001


@dataclass(frozen=True)
class DeviceInfo:
    """One OpenCL device, as its driver describes it.

    Attributes
    ----------
    number : int
        Position in `list_devices`; what ``--device 0`` refers to.
    platform, platform_version : str
        The driver the device belongs to.
    name, vendor, version, driver_version : str
        The device's own words; `version` is the OpenCL version it offers.
    kind : str
        ``"gpu"``, ``"accelerator"``, ``"cpu"`` or ``"other"``.
    memory_bytes, max_allocation_bytes : int
        All of the device's memory, and the largest single buffer.
    compute_units : int
        Cores of a CPU, multiprocessors of a GPU.
    has_fp64 : bool
        Whether kernels may use double precision.
    has_unified_memory : bool
        Whether it shares the host's memory: a CPU, or a GPU inside one.
    is_available : bool
        False when the driver itself says that the device, or its compiler, cannot be used.
    cl_device : pyopencl.Device
        The device itself; None in a description that was made up.
    """

    number: int
    platform: str
    platform_version: str
    name: str
    vendor: str
    version: str
    driver_version: str
    kind: str
    memory_bytes: int
    max_allocation_bytes: int
    compute_units: int
    has_fp64: bool
    has_unified_memory: bool = False
    is_available: bool = True
    cl_device: Any = field(default=None, repr=False, compare=False)

    @property
    def layout(self) -> str:
        """The tree layout this device would traverse."""
        return preferred_layout(self)

    def as_dict(self) -> dict[str, Any]:
        """Return everything that can be written as JSON, `layout` included."""
        # `dataclasses.asdict` would try to copy the handle, which belongs to the driver.
        facts = {name: value for name, value in vars(self).items() if name != "cl_device"}
        return facts | {"layout": self.layout}

    def __str__(self) -> str:
        return f"{self.number}: {self.name} ({self.platform})"


@dataclass(frozen=True)
class DeviceSurvey:
    """What all platforms answered.

    Attributes
    ----------
    devices : tuple of DeviceInfo
        Numbered from 0, the one that the default prefers first.
    problems : tuple of str
        One sentence for each platform or device that had to be left out.
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
    try:
        import pyopencl
    except (ImportError, OSError) as error:
        raise DeviceError(f"pyopencl cannot be imported ({error}): run `clbvh doctor` for what to do") from error
    return pyopencl


def survey_devices() -> DeviceSurvey:
    """Ask every platform for its devices, and remember what went wrong on the way.

    A platform or a device whose queries fail is left out: one broken driver must not hide the others.

    Raises
    ------
    DeviceError
        `pyopencl` cannot be imported.
    """
    cl = import_pyopencl()
    devices: list[DeviceInfo] = []
    problems: list[str] = []

    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        if error.code != _PLATFORM_NOT_FOUND:
            problems.append(f"the OpenCL loader fails: {error}")
        platforms = []

    for place, platform in enumerate(platforms):
        try:
            platform_name = _tidy(platform.name)
            found = platform.get_devices()
        except cl.Error as error:
            problems.append(f"platform {place} cannot be asked for its devices: {error}")
            continue
        if not found:
            problems.append(f"the platform '{platform_name}' offers no device")
        for cl_device in found:
            try:
                devices.append(_describe(cl, platform, cl_device))
            except cl.Error as error:
                problems.append(f"a device of the platform '{platform_name}' cannot be described: {error}")

    return DeviceSurvey(number_devices(devices), tuple(problems))


def list_devices() -> list[DeviceInfo]:
    """Return all usable devices, numbered from 0 in an order that depends on the devices alone.

    Empty when no driver is registered.

    Raises
    ------
    DeviceError
        `pyopencl` cannot be imported.
    """
    return list(survey_devices().devices)


def choose_device(spec: str | int | None = None) -> DeviceInfo:
    """Return the device to use.

    Parameters
    ----------
    spec : str or int, optional
        A number of `list_devices`; ``"gpu"``, ``"accelerator"`` or ``"cpu"``; or a part of the name of a device
        or its platform, in any case. Without it, the environment variable ``CLBVH_DEVICE`` decides,
        and without that the best device is taken: a GPU, else an accelerator, else a CPU.

    Raises
    ------
    DeviceError
        There is no device at all, none matches, or different ones match.
    """
    asked_by = ""
    if spec is None or spec == "":
        spec = os.environ.get(DEVICE_VARIABLE, "").strip() or None
        asked_by = f" (asked for by {DEVICE_VARIABLE})" if spec is not None else ""
    survey = survey_devices()
    if not survey.devices:
        reason = f" ({survey.problems[0]})" if survey.problems else ""
        raise DeviceError(f"no OpenCL device was found{reason}: run `clbvh doctor` to see what is missing")
    return pick_device(survey.devices, spec, asked_by)


def pick_device(devices: Sequence[DeviceInfo], spec: str | int | None, asked_by: str = "") -> DeviceInfo:
    """Return the device of `devices` that `spec` means; the choice behind `choose_device`.

    Parameters
    ----------
    devices : sequence of DeviceInfo
        At least one, in the order of preference, `number` being the position.
    spec : str or int, optional
        As for `choose_device`, without the environment variable.
    asked_by : str
        Who asked, for the message of an error.

    Raises
    ------
    DeviceError
        None matches, or different ones match.
    """
    if spec is None:
        return devices[0]
    there_are = "there are " + "; ".join(str(device) for device in devices)

    word = str(spec).strip().lower()
    if isinstance(spec, int) or word.isdecimal():
        number = int(word)
        if 0 <= number < len(devices):
            return devices[number]
        # "4090" is no number of a device here, but may well be a part of a name.
        if isinstance(spec, int):
            raise DeviceError(f"there is no device {number}{asked_by}: {there_are}")

    if word in KINDS:
        matches = [device for device in devices if device.kind == word]
    else:
        # The full name beats a part of a longer one: "Tesla T4" must not be ambiguous beside "Tesla T4G".
        matches = [device for device in devices if device.name.lower() == word]
        matches = matches or [device for device in devices if word in _searchable_text(device)]
    if not matches:
        raise DeviceError(f"no device matches '{spec}'{asked_by}: {there_are}")
    if word not in KINDS and not all(_is_same_hardware(matches[0], other) for other in matches[1:]):
        listed = "; ".join(str(device) for device in matches)
        raise DeviceError(f"'{spec}'{asked_by} matches several devices, give a number or a longer name: {listed}")
    return matches[0]


def number_devices(devices: Sequence[DeviceInfo]) -> tuple[DeviceInfo, ...]:
    """Sort the devices by preference and number them.

    The order of the platforms is the order of the files in a folder, which differs between machines and from
    one installation to the next; so it decides only between devices that are alike in everything else.
    """
    ordered = sorted(devices, key=_preference)
    return tuple(replace(device, number=number) for number, device in enumerate(ordered))


def preferred_layout(info: DeviceInfo) -> str:
    """Return the tree layout of a device when the user does not choose one: the measured one, or that of its kind."""
    return find_settings(info).layout


def _describe(cl: Any, platform: Any, cl_device: Any) -> DeviceInfo:
    """Ask one device for its properties; its number is not known yet."""

    def ask_if_known(name: str, otherwise: Any) -> Any:
        # Drivers may refuse a query that is newer than they are, or that they hold to be obsolete.
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
    # The bits can be combined with DEFAULT, so they are tested one by one.
    if type_bits & cl.device_type.GPU:
        return "gpu"
    if type_bits & cl.device_type.ACCELERATOR:
        return "accelerator"
    if type_bits & cl.device_type.CPU:
        return "cpu"
    return "other"


def _tidy(text: str) -> str:
    """Return a driver's text on one line, without the padding and the final zero that some drivers add."""
    return " ".join(text.replace("\0", " ").split())


def _preference(device: DeviceInfo) -> tuple[Any, ...]:
    """Return a sorting key: what the default should take comes first."""
    rank = KINDS.index(device.kind) if device.kind in KINDS else len(KINDS)
    # Intel's emulator of its FPGA boards says "accelerator", and is slower than the CPU that it runs on.
    if "emulation" in device.name.lower():
        rank = len(KINDS)
    is_gpu = device.kind == "gpu"
    return (
        not device.is_available,
        rank,
        # A graphics card before the graphics unit of the CPU, which may claim all of the host's memory.
        is_gpu and device.has_unified_memory,
        -device.memory_bytes if is_gpu else 0,
        device.platform,
        # Of two installed versions of one driver, the newer.
        tuple(-int(digits) for digits in re.findall(r"\d+", device.driver_version)),
        device.name,
    )


def _searchable_text(device: DeviceInfo) -> str:
    # The version is in it because PoCL has its short name only there. The vendor is not: PoCL takes it from the
    # CPU, "AuthenticAMD", and `--device amd` should mean the graphics card.
    return f"{device.name}\n{device.platform}\n{device.platform_version}".lower()


def _is_same_hardware(one: DeviceInfo, other: DeviceInfo) -> bool:
    """Tell whether it makes no difference to the user which of two devices is taken.

    Two drivers for the CPU drive the same CPU; two cards of one name are as good as each other.
    """
    if one.kind != other.kind:
        return False
    return one.kind == "cpu" or one.name == other.name

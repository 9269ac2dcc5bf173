"""The OpenCL devices of this machine, and the choice among them.

Asks every platform for its devices and picks one, in the order of `preference.py` and by the same file's rules. Must
not know why a device is missing: that is `doctor.py`. `pyopencl` is imported on first use, so that a machine
without a working OpenCL loader gets a `DeviceError` instead of a traceback.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

from ..errors import DeviceError
from .context import claim_opencl
from .driver_files import added_drivers, prepare_pocl_folder
from .info import DeviceInfo
from .pocl_cpu_name import name_unknown_cpu
from .pocl_linker import explain_missing_linker
from .preference import KINDS, number_devices, pick_device
from .settings import find_settings

DEVICE_VARIABLE = "CLBVH_DEVICE"

# The error code of an OpenCL loader without a registered driver (extension cl_khr_icd).
_PLATFORM_NOT_FOUND = -1001


@dataclass(frozen=True)
class DeviceSurvey:
    """The answers of all platforms.

    Attributes
    ----------
    devices : tuple of DeviceInfo
        Numbered from 0, the default first.
    problems : tuple of str
        One sentence for each platform or device that was left out.
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
        raise DeviceError(f"pyopencl cannot be imported ({error}): run `clbvh doctor` for advice") from error
    return pyopencl


def survey_devices() -> DeviceSurvey:
    """Ask every platform for its devices, and list the failures.

    A platform or a device whose queries fail is left out: one broken driver must not hide the others.

    Raises
    ------
    DeviceError
        `pyopencl` cannot be imported, or this process was forked from one that has used OpenCL.
    """
    cl = import_pyopencl()
    claim_opencl()
    devices: list[DeviceInfo] = []
    problems: list[str] = []

    try:
        with added_drivers():
            platforms = cl.get_platforms()
    except cl.Error as error:
        if error.code != _PLATFORM_NOT_FOUND:
            problems.append(f"the OpenCL loader fails: {error}")
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
                device = _describe(cl, platform, cl_device)
            except cl.Error as error:
                problems.append(f"a device of the platform '{platform_name}' cannot be described: {error}")
                continue
            name_unknown_cpu(device)
            if reason := explain_missing_linker(device.driver_version):
                problems.append(reason)
                device = replace(device, is_available=False)
            devices.append(device)

    return DeviceSurvey(number_devices(devices, lambda device: find_settings(device).measured_ms), tuple(problems))


def list_devices() -> list[DeviceInfo]:
    """Return all usable devices, numbered from 0 in an order that depends on the devices alone.

    Empty if no driver is registered.

    Raises
    ------
    DeviceError
        `pyopencl` cannot be imported, or this process was forked from one that has used OpenCL.

    Examples
    --------
    >>> import clbvh
    >>> [device.number for device in clbvh.list_devices()][:1]
    [0]
    """
    return list(survey_devices().devices)


def choose_device(spec: str | int | None = None) -> DeviceInfo:
    """Return the device to use.

    Parameters
    ----------
    spec : str or int, optional
        A number of `list_devices`; ``"gpu"``, ``"accelerator"`` or ``"cpu"``; a part of the name of a device or its
        platform, in upper or lower case; or both, as in ``"intel gpu"``. The maker of a processor, as in ``"intel"``,
        means that maker's driver or graphics card, not the processor under another driver. Without it the environment
        variable ``CLBVH_DEVICE`` decides, and without that the best device is taken: a GPU, else an accelerator, else a
        CPU; of one kind the fastest that `clbvh tune` measured.

    Raises
    ------
    DeviceError
        There is no device at all, none matches, or different ones match; or this process was forked from one that has
        used OpenCL.

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
    survey = survey_devices()
    if not survey.devices:
        reason = f" ({survey.problems[0]})" if survey.problems else ""
        raise DeviceError(f"no OpenCL device was found{reason}: run `clbvh doctor` to find the cause")
    return pick_device(survey.devices, spec, asked_by)


def find_again(device: DeviceInfo) -> DeviceInfo:
    """Return a description with its handle, which copies and pickles have lost.

    Raises
    ------
    DeviceError
        This process has no such device.
    """
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

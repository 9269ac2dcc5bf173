"""The description of the host as a device."""

from __future__ import annotations

import platform
import re
from functools import cache
from pathlib import Path

import psutil

from ...support.host_threads import usable_cores
from ...support.version import __version__
from ..info import HOST_PLATFORM, DeviceInfo
from .library import open_library


@cache
def describe_host() -> DeviceInfo:
    """Return the host, number 0 of all devices.

    Raises
    ------
    DeviceError
        The library of kernels is missing, does not fit its sources, or is for newer processors.
    """
    library = open_library()
    memory = int(psutil.virtual_memory().total)
    name, maker = _name_processor()
    return DeviceInfo(
        number=0,
        platform=HOST_PLATFORM,
        platform_version=library.digest[:8],
        name=name,
        vendor=maker,
        version=f"level {library.level}",
        driver_version=f"{__version__} {library.level}",
        kind="cpu",
        memory_bytes=memory,
        max_allocation_bytes=memory,
        compute_units=usable_cores(),
        has_fp64=True,
        has_unified_memory=True,
    )


def _name_processor() -> tuple[str, str]:
    """Return the name of the processor and its maker, as far as the system tells."""
    try:
        text = Path("/proc/cpuinfo").read_text(errors="replace")
    except OSError:
        text = ""
    found = {key: re.search(rf"^{key}\s*: (.+)$", text, re.MULTILINE) for key in ("model name", "vendor_id")}
    name, maker = (match[1].strip() if match else "" for match in found.values())
    return name or platform.processor() or platform.machine(), maker

"""Opens a device: the host, or one of OpenCL."""

from __future__ import annotations

from .host.session import HostSession
from .info import DeviceInfo
from .opencl_session import OpenclSession
from .select import choose_device, find_again
from .session import DeviceSession


def open_device(device: DeviceInfo | str | int | None = None) -> DeviceSession:
    """Open a device.

    Parameters
    ----------
    device : DeviceInfo, str, int or None
        The device, or what `choose_device` takes.

    Raises
    ------
    DeviceError
        There is no such device, its driver refuses, or this process was forked from one that has used OpenCL.
    """
    info = find_again(device) if isinstance(device, DeviceInfo) else choose_device(device)
    if info.is_host:
        return HostSession(info)
    return OpenclSession(info)

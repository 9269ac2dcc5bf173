"""OpenCL: which devices there are, how to open one, and how to compile for it."""

from .info import DeviceInfo
from .select import choose_device, list_devices

__all__ = ["DeviceInfo", "choose_device", "list_devices"]

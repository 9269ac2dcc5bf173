"""OpenCL: which devices there are, how to open one, and how to compile for it."""

from .select import DeviceInfo, choose_device, list_devices

__all__ = ["DeviceInfo", "choose_device", "list_devices"]

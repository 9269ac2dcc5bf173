"""A device's context: one for all sessions of a process, with the kernels that have been compiled in it.

A driver may keep memory for each context in which a kernel ran, released or not: PoCL 3.0 keeps 1.1 MiB for each
compiled program. With one context per device, a program is compiled and loaded once in a process.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any

from .info import DeviceInfo
from .kernel import Kernel
from .owner_process import hold_handles

Kernels = dict[str, Kernel]

_contexts: dict[Any, DeviceContext] = {}
_contexts_lock = threading.Lock()


class DeviceContext:
    """The context of one device, and its kernels; from any number of threads.

    Parameters
    ----------
    cl_device : pyopencl.Device

    Attributes
    ----------
    context : pyopencl.Context
    """

    def __init__(self, cl_device: Any) -> None:
        import pyopencl as cl

        self._queue_type: Any = cl.CommandQueue
        self._queue_properties = cl.command_queue_properties.PROFILING_ENABLE
        self.context = cl.Context([cl_device])
        self._kernels: dict[Hashable, Kernels] = {}
        self._compiling = threading.Lock()
        hold_handles(self)

    def list_handles(self) -> list[Any]:
        """Return all that must outlive a fork; see `hold_handles`."""
        return list(vars(self).values())

    def open_queue(self) -> Any:
        """Return a new queue, which runs its commands one after the other."""
        return self._queue_type(self.context, properties=self._queue_properties)

    def kernels(self, key: Hashable, compile_them: Callable[[], Kernels]) -> Kernels:
        """Return the kernels of a key, compiled when first asked for."""
        if key not in self._kernels:
            # One at a time: two threads that need the same program compile it once.
            with self._compiling:
                if key not in self._kernels:
                    self._kernels[key] = compile_them()
        return self._kernels[key]


def open_context(info: DeviceInfo) -> DeviceContext:
    """Return the context of a device, created when first asked for; it stays for the rest of the process."""
    with _contexts_lock:
        if info.cl_device not in _contexts:
            _contexts[info.cl_device] = DeviceContext(info.cl_device)
        return _contexts[info.cl_device]


def forget_context(context: DeviceContext) -> None:
    """Let sessions that open later have another context: the driver has given up on this one."""
    with _contexts_lock:
        for cl_device, known in list(_contexts.items()):
            if known is context:
                del _contexts[cl_device]

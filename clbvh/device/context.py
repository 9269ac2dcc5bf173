"""OpenCL in this process: a context for each device, its compiled kernels, and forked children.

One context serves all sessions of a device: PoCL 3.0 keeps 1.1 MiB for each program that it has compiled, released or
not, so a program is compiled and loaded once in a process. A driver runs threads, and a fork copies none of them: a
child that calls the driver waits for ever. So a forked child refuses to use OpenCL, and never releases the handles that
it inherited.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Hashable, Iterable
from typing import Any, ClassVar
from weakref import WeakSet

from ..errors import DeviceError
from .info import DeviceInfo
from .kernel import Kernel


class _OpenCL:
    """The use of OpenCL in this process. Flags, not process ids: every step of a query looks at them."""

    is_started: ClassVar[bool] = False
    is_inherited: ClassVar[bool] = False
    sessions: ClassVar[WeakSet[Any]] = WeakSet()
    kept: ClassVar[list[Any]] = []  # handles that must never be released


def claim_opencl() -> None:
    """Let OpenCL belong to this process, before the first call of a driver.

    Raises
    ------
    DeviceError
        It belongs to a process that this one was forked from.
    """
    check_process()
    if not _OpenCL.is_started:
        if hasattr(os, "register_at_fork"):  # Windows does not fork
            os.register_at_fork(after_in_child=_notice_fork)
        _OpenCL.is_started = True


def is_inherited() -> bool:
    """Return whether this process was forked from one that had started OpenCL."""
    return _OpenCL.is_inherited


def check_process() -> None:
    """Raise `DeviceError` if this process was forked from one that had started OpenCL."""
    if _OpenCL.is_inherited:
        raise DeviceError(
            "this process was forked from one that had already used OpenCL, which works only in that one: start it by "
            "multiprocessing's 'spawn' or 'forkserver' (as in DataLoader(multiprocessing_context='spawn')), or fork "
            "before the first tracer, picture or list of devices"
        )


def note_session(session: Any) -> None:
    """Note a session: a forked child keeps what its `list_handles` returns."""
    _OpenCL.sessions.add(session)


def keep_for_ever(handle: Any) -> None:
    """Let no reference count and no end of the interpreter release a handle."""
    _OpenCL.kept.append(handle)
    # The list outlives the module, and so does all that is in it.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(_OpenCL.kept))


def _notice_fork() -> None:
    """Keep all handles, in a child that has just been forked."""
    _OpenCL.is_inherited = True
    keep_for_ever([dict(_contexts), [session.list_handles() for session in list(_OpenCL.sessions)]])


class OpenclKernel(Kernel):
    """A compiled entry point of a driver's program.

    Parameters
    ----------
    cl_kernel : pyopencl.Kernel
        Also an attribute.
    argument_names : iterable of str
        In the order of the declaration.
    """

    def __init__(self, cl_kernel: Any, argument_names: Iterable[str]) -> None:
        super().__init__(str(cl_kernel.function_name), argument_names)
        self.cl_kernel = cl_kernel
        # The driver takes the arguments one by one, before the launch.
        self._one_launch = threading.Lock()

    def enqueue(self, queue: Any, work_size: tuple[int, ...], work_group: tuple[int, ...], arguments: Any) -> Any:
        """Start the kernel and return its event."""
        with self._one_launch:
            return self.cl_kernel(queue, work_size, work_group, *arguments)


Kernels = dict[str, OpenclKernel]

_contexts: dict[Any, DeviceContext] = {}
_contexts_lock = threading.Lock()


class DeviceContext:
    """The context of one device, and its kernels; from any number of threads.

    Parameters
    ----------
    context : pyopencl.Context
    """

    def __init__(self, context: Any) -> None:
        self.context = context
        self._kernels: dict[Hashable, Kernels] = {}
        self._compiling = threading.Lock()

    def kernels(self, key: Hashable, compile_them: Callable[[], Kernels]) -> Kernels:
        """Return the kernels of a key, compiled when first asked for."""
        if key not in self._kernels:
            # One at a time: two threads that need the same program compile it once.
            with self._compiling:
                if key not in self._kernels:
                    self._kernels[key] = compile_them()
        return self._kernels[key]

    def list_kernels(self) -> list[OpenclKernel]:
        """Return all kernels that were compiled so far."""
        return [kernel for kernels in self._kernels.values() for kernel in kernels.values()]


def open_context(info: DeviceInfo, context: Any = None) -> DeviceContext:
    """Return a device's context, created when first asked for, or a user's; either stays as long as the process."""
    import pyopencl as cl

    key = info.cl_device if context is None else context
    with _contexts_lock:
        if key not in _contexts:
            _contexts[key] = DeviceContext(context or cl.Context([info.cl_device]))
        return _contexts[key]


def forget_context(context: DeviceContext | None) -> None:
    """Let sessions that open later have another context: the driver has given up on this one."""
    with _contexts_lock:
        for key in [key for key, known in _contexts.items() if known is context]:
            del _contexts[key]

"""OpenCL belongs to the process that started it.

A driver runs threads, and a fork copies none of them: a child that calls the driver waits for ever for threads that do
not exist. So a forked child refuses to use OpenCL, and never releases the handles that it inherited.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any, ClassVar
from weakref import WeakSet

from ..errors import DeviceError


class _Owner:
    """The process that started OpenCL, and the objects that hold its handles."""

    process_id: ClassVar[int | None] = None
    holders: ClassVar[WeakSet[Any]] = WeakSet()
    kept: ClassVar[list[Any]] = []


def claim_opencl() -> None:
    """Let OpenCL belong to this process, before the first call of a driver.

    Raises
    ------
    DeviceError
        It belongs to a process that this one was forked from.
    """
    check_process()
    if _Owner.process_id is None:
        if hasattr(os, "register_at_fork"):  # Windows does not fork
            os.register_at_fork(after_in_child=_keep_handles)
        _Owner.process_id = os.getpid()


def is_inherited() -> bool:
    """Return whether this process was forked from one that had started OpenCL."""
    return _Owner.process_id is not None and _Owner.process_id != os.getpid()


def check_process() -> None:
    """Raise `DeviceError` if this process was forked from one that had started OpenCL."""
    if is_inherited():
        raise DeviceError(
            "this process was forked from one that had already used OpenCL, which works only in that one: start it by "
            "multiprocessing's 'spawn' or 'forkserver' (as in DataLoader(multiprocessing_context='spawn')), or fork "
            "before the first tracer, picture or list of devices"
        )


def hold_handles(holder: Any) -> None:
    """Note an object whose attributes hold handles of the driver."""
    _Owner.holders.add(holder)


def keep_for_ever(handle: Any) -> None:
    """Let no reference count and no end of the interpreter release a handle."""
    _Owner.kept.append(handle)
    # The list outlives the module, and so what is in it.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(_Owner.kept))


def _keep_handles() -> None:
    """Keep all handles, in a child that has just been forked."""
    for holder in list(_Owner.holders):
        keep_for_ever(vars(holder).copy())

"""OpenCL belongs to the process that started it.

A driver runs threads, and a fork copies none of them: a child that calls the driver waits for ever for threads that do
not exist. So a forked child refuses to use OpenCL, and never releases the handles that it inherited.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any, ClassVar, Protocol
from weakref import WeakSet

from ..errors import DeviceError


class HandleHolder(Protocol):
    """An object that knows handles of the driver."""

    def list_handles(self) -> list[Any]:
        """Return the handles, or objects that refer to them."""


class _OpenCL:
    """The use of OpenCL in this process; asked at every step of a query, so by two flags instead of process ids."""

    is_started: ClassVar[bool] = False
    is_inherited: ClassVar[bool] = False
    # Objects that know handles of the driver, and what must never be released.
    holders: ClassVar[WeakSet[HandleHolder]] = WeakSet()
    kept: ClassVar[list[Any]] = []


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


def hold_handles(holder: HandleHolder) -> None:
    """Note an object that knows handles of the driver."""
    _OpenCL.holders.add(holder)


def keep_for_ever(handle: Any) -> None:
    """Let no reference count and no end of the interpreter release a handle."""
    _OpenCL.kept.append(handle)
    # The list outlives the module, and so does all that is in it.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(_OpenCL.kept))


def _notice_fork() -> None:
    """Keep all handles, in a child that has just been forked."""
    _OpenCL.is_inherited = True
    for holder in list(_OpenCL.holders):
        keep_for_ever(holder.list_handles())

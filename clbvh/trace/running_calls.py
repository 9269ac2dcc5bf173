"""The calls that are running on one tree: each with memory of its own, and all of them ended before the tree goes.

Calls come from any number of threads. Ctrl-C may strike between any two steps, so nothing depends on a step being
reached: what is lent goes back when the call is left or, failing that, when the next call finds that it is garbage.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self
from weakref import ref

from ..device.session import DeviceSession, ReusableBuffer
from ..errors import DeviceMemoryError, QueryError
from ..support.forks import make_lock, renew_in_child

# Memory of calls that have ended is kept for later ones: that of one call, whatever its size, and that of others up to
# these bounds. Many threads at once do not leave the memory of all behind.
_KEPT_BYTES = 2**25
_KEPT_COUNT = 32

# How often a thread that closes looks whether the calls of other threads have ended. Polling cannot miss an end.
_POLL_S = 0.005


class CallMemory:
    """A queue of the device and the buffers of one call at a time.

    Parameters
    ----------
    tree_session : DeviceSession
        That of the tree; the memory gets a branch of it.
    """

    def __init__(self, tree_session: DeviceSession) -> None:
        self.session = tree_session.branch()
        self._buffers: dict[str, ReusableBuffer] = {}

    def buffer(self, name: str, *, for_mapping: bool) -> ReusableBuffer:
        """Return the buffer of a name; see `ReusableBuffer`."""
        if name not in self._buffers:
            self._buffers[name] = ReusableBuffer(self.session, for_mapping=for_mapping)
        return self._buffers[name]

    @property
    def byte_count(self) -> int:
        """Bytes of all buffers."""
        return sum(buffer.size for buffer in self._buffers.values())

    def release(self) -> None:
        """Give all buffers back; the memory cannot be used again."""
        self.session.close()


@dataclass
class _Loan:
    """What a running call has: its thread, and its memory once there is one."""

    call: ref[Any]
    thread_id: int
    memory: CallMemory | None


class RunningCalls:
    """Lends memory to the calls on one tree, and keeps that of some calls that have ended.

    Parameters
    ----------
    tree_session : DeviceSession
        Closed with the calls.
    owner : str
        Name of the object that the user closes, for messages.

    Attributes
    ----------
    is_closed : bool
        Whether new calls are refused.
    halvings : int
        Of the usual batch, since the device did not hold it.
    """

    def __init__(self, tree_session: DeviceSession, owner: str = "tracer") -> None:
        self._tree_session = tree_session
        self._owner = owner
        self._lock = make_lock()
        self.is_closed = False
        self.halvings = 0
        self._idle: list[CallMemory] = []
        self._loans: dict[int, _Loan] = {}  # by the identity of the call
        self._closing: set[int] = set()  # threads that wait in `close`
        renew_in_child(self)

    def check_open(self) -> None:
        """Raise `QueryError` if the tree is no longer on the device."""
        if self.is_closed or self._tree_session.is_closed:
            raise QueryError(f"the {self._owner} is closed: its tree is no longer on the device")

    def begin(self, call: object) -> CallMemory:
        """Let a call begin, and lend it memory; `end` takes it back, also after an error here.

        Raises
        ------
        QueryError
            The tree is no longer on the device.
        DeviceError
            This process was forked from one that has used OpenCL, or the driver refuses.
        """
        self._tree_session.check_process()
        with self._lock:
            self.check_open()
            self._drop_lost_loans()
            loan = _Loan(ref(call), threading.get_ident(), self._idle.pop() if self._idle else None)
            self._loans[id(call)] = loan
        if loan.memory is None:
            loan.memory = CallMemory(self._tree_session)
        return loan.memory

    def end(self, call: object, *, gives_up_memory: bool) -> None:
        """Let a call end, and take its memory back. A second time changes nothing.

        Parameters
        ----------
        call : object
        gives_up_memory : bool
            Whether the device gets the memory back: the call has left commands behind that use it, or it did not fit.
        """
        with self._lock:
            loan = self._loans.pop(id(call), None)
            memory = None if loan is None else loan.memory
            if memory is not None:
                if not gives_up_memory and self._is_kept(memory):
                    self._idle.append(memory)
                else:
                    memory.release()
            if self.is_closed:
                self._release_after_last()

    def close(self) -> None:
        """Refuse new calls, wait until those of other threads have ended, and give the device's memory back.

        A call whose progress function closes the tracer keeps its memory until it ends, and nobody waits for it.
        """
        self.is_closed = True
        self._closing.add(threading.get_ident())
        try:
            while self._is_used_elsewhere():
                time.sleep(_POLL_S)
        finally:
            self._closing.discard(threading.get_ident())
        self._release_after_last()

    def release_idle(self) -> None:
        """Give back the memory of calls that have ended."""
        with self._lock:
            while self._idle:
                self._idle.pop().release()

    def start_anew(self) -> None:
        """End the calls of threads that a forked child does not have."""
        own = threading.get_ident()
        self._loans = {key: loan for key, loan in self._loans.items() if loan.thread_id == own}
        self._closing &= {own}

    def _drop_lost_loans(self) -> None:
        """End the calls that Ctrl-C has kept from ending: nobody refers to them any more."""
        # Not by a finalizer: Python drops an exception that strikes there, and so Ctrl-C.
        for key, loan in list(self._loans.items()):
            if loan.call() is None:
                del self._loans[key]

    def _is_kept(self, memory: CallMemory) -> bool:
        kept_bytes = memory.byte_count + sum(other.byte_count for other in self._idle)
        return not self._idle or (kept_bytes <= _KEPT_BYTES and len(self._idle) < _KEPT_COUNT)

    def _is_used_elsewhere(self) -> bool:
        with self._lock:
            self._drop_lost_loans()
            return any(loan.thread_id not in self._closing for loan in self._loans.values())

    def _release_after_last(self) -> None:
        """Give everything back unless a call is running."""
        with self._lock:
            if not self._loans:
                self.release_idle()
                self._tree_session.close()


class MemoryLoan:
    """The base of calls: memory of their own for the length of a `with` block.

    Parameters
    ----------
    calls : RunningCalls

    Attributes
    ----------
    memory : CallMemory
        Inside the block.
    """

    memory: CallMemory

    def __init__(self, calls: RunningCalls) -> None:
        self._calls = calls

    def __enter__(self) -> Self:
        try:
            self.memory = self._calls.begin(self)
        except BaseException:
            self._calls.end(self, gives_up_memory=True)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        gives_up_memory = isinstance(error, DeviceMemoryError) or not isinstance(error, Exception | None)
        self._calls.end(self, gives_up_memory=gives_up_memory)

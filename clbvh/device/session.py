"""An opened device: one interface for the host and for devices of OpenCL; docs/internals/session.md describes it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from ..support.context_manager import ContextManager
from ..support.host_threads import HostThreads
from .info import DeviceInfo
from .settings import Settings, find_settings
from .times import CommandTimes


class DeviceSession(ContextManager):
    """One device, opened, for one thread at a time; a context manager. `open_device` returns one.

    A buffer is on the device until nothing refers to it, until `release`, or until the session is closed; its `size` is
    in bytes.

    Attributes
    ----------
    info : DeviceInfo
    settings : Settings
        How kernels are launched on it.
    times : CommandTimes
        Times of all commands of this session and its branches.
    threads : HostThreads
        For work of the host, shared with its branches.
    is_closed : bool
        True once the buffers are gone.
    context, queue : pyopencl.Context, pyopencl.CommandQueue, or None
        None for the host.
    """

    info: DeviceInfo
    settings: Settings
    times: CommandTimes
    threads: HostThreads
    context: Any = None
    queue: Any = None

    def __init__(
        self,
        info: DeviceInfo,
        parent: DeviceSession | None = None,
        times: CommandTimes | None = None,
        thread_count: int | None = None,
    ) -> None:
        self.info = info
        self.settings = find_settings(info) if parent is None else parent.settings
        self.threads = HostThreads(thread_count) if parent is None else parent.threads
        self.times = times or (CommandTimes() if parent is None else parent.times)
        self.is_closed = False
        self._is_branch = parent is not None
        # Weak references: a buffer that Ctrl-C keeps from its owner is freed at once. Not a WeakSet: its callbacks are
        # Python code, in which Ctrl-C would be lost.
        self._buffers: set[ref[Any]] = set()

    @abstractmethod
    def branch(self, times: CommandTimes | None = None) -> DeviceSession:
        """Return another session on the same device, for another thread; it uses the buffers of this one as well.

        Its commands are noted in `times`; by default in those of this session.

        Raises
        ------
        DeviceError
            The driver refuses.
        """

    @abstractmethod
    def kernels(
        self, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None
    ) -> Mapping[str, Any]:
        """Return the entry points of ``kernels/NAME.cl`` by name.

        Parameters
        ----------
        name : str
        defines : mapping of str to int, optional
            Macros; the tunables and sizes that the source asks for.
        folder : Path, optional
            Where files are looked for before the shipped `cl`.

        Raises
        ------
        KernelBuildError
            The device's compiler refuses; the message has its log.
        """

    def kernel(self, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None) -> Any:
        """Return the entry point of ``kernels/NAME.cl`` that has the file's name; see `kernels`."""
        return self.kernels(name, defines, folder=folder)[name]

    @property
    def buffer_count(self) -> int:
        """Buffers that are on the device."""
        return len(self._buffers)

    def _note(self, buffer: Any) -> None:
        """Count a new buffer, until nothing refers to it."""
        self._buffers.add(ref(buffer, self._buffers.discard))

    def _forget(self, buffer: Any) -> None:
        """Stop counting a buffer that is given back."""
        self._buffers.discard(ref(buffer))

    def _list_buffers(self) -> list[Any]:
        return [buffer for reference in list(self._buffers) if (buffer := reference()) is not None]

    @abstractmethod
    def allocate(self, size: int, *, writable: bool = True, for_mapping: bool = False) -> Any:
        """Return a new buffer of `size` bytes; `for_mapping` where the host can reach it without a copy.

        Raises
        ------
        DeviceError
            A `DeviceMemoryError`: the size is above the device's largest allocation, or it has no memory for it.
        """

    def upload(self, array: NDArray[Any]) -> Any:
        """Copy an array into a new read-only buffer."""
        buffer = self.allocate(array.nbytes, writable=False)
        if array.nbytes:
            self.write(buffer, array)
        return buffer

    @abstractmethod
    def make_array(self, shape: tuple[int, ...], dtype: Any, values: NDArray[Any] | None = None) -> Any:
        """Return an array on the device with these values, if any, which lives as long as somebody refers to it.

        Raises
        ------
        DeviceError
            See `allocate`.
        """

    @abstractmethod
    def memory_of(self, array: Any) -> Any:
        """Return the memory behind an array of `make_array`: an argument for kernels, and a source of copies."""

    def fit_items(self, item_bytes: int, wanted: int) -> int:
        """Return how many items of this size one buffer can hold, `wanted` at most and 1 at least."""
        return max(1, min(wanted, self.info.max_allocation_bytes // item_bytes))

    @abstractmethod
    def release(self, buffer: Any) -> None:
        """Give a buffer back although something may refer to it."""

    @abstractmethod
    def write(self, buffer: Any, array: NDArray[Any], *, begin: int = 0) -> None:
        """Copy an array into an existing buffer, from a byte of it on."""

    @abstractmethod
    def copy(self, source: Any, target: Any, size: int, *, source_begin: int = 0, target_begin: int = 0) -> None:
        """Copy `size` bytes of a buffer into another one, each from its own byte on."""

    @abstractmethod
    def download(self, buffer: Any, into: NDArray[Any], *, begin: int = 0) -> None:
        """Copy a buffer, from a byte of it on, into a contiguous array, filling it."""

    @abstractmethod
    def mapped(
        self, buffer: Any, item_count: int, dtype: np.dtype, *, write: bool, first: int = 0
    ) -> AbstractContextManager[NDArray[Any]]:
        """Give a part of a buffer as an array, to fill or to read.

        Parameters
        ----------
        buffer : buffer
        item_count : int
            At least 1.
        dtype : numpy.dtype
        write : bool
            True: all of the array is to be filled. False: it may only be read.
        first : int
            Items before the part.
        """

    @abstractmethod
    def run(self, kernel: Any, work_size: tuple[int, ...], work_group: tuple[int, ...], **arguments: Any) -> None:
        """Run a kernel once per work-item, after all commands before it.

        Parameters
        ----------
        kernel : Kernel
            One of `kernels`.
        work_size : tuple of int
            Work-items per dimension, rounded up to whole work-groups: the kernel checks its range.
        work_group : tuple of int
            Work-items of a work-group per dimension.
        **arguments
            The kernel's arguments by name: buffers, numbers of numpy, or None for a missing array.
        """

    @abstractmethod
    def finish(self) -> None:
        """Wait for all commands of this session: other sessions may use what they have written."""

    @abstractmethod
    def check_process(self) -> None:
        """Raise `DeviceError` if this process was forked, and the device works only in the one that opened it."""

    def close(self) -> None:
        """Give all buffers back, and end the threads unless this is a branch. Closing twice is allowed."""
        self.is_closed = True
        for buffer in self._list_buffers():
            self.release(buffer)
        if not self._is_branch:
            self.threads.close()


class ReusableBuffer:
    """One buffer of a session, allocated when first taken.

    Parameters
    ----------
    session : DeviceSession
    for_mapping : bool
        See `DeviceSession.allocate`.
    """

    def __init__(self, session: DeviceSession, *, for_mapping: bool = False) -> None:
        self._session = session
        self._for_mapping = for_mapping
        self._buffer: Any = None
        self.size = 0  # bytes; 0 without a buffer

    def take(self, size: int) -> Any:
        """Return the buffer, with room for at least `size` bytes; it is replaced by a larger one where needed."""
        if self._buffer is None or size > self.size:
            self.release()
            self._buffer = self._session.allocate(size, for_mapping=self._for_mapping)
            self.size = size
        return self._buffer

    def release(self) -> None:
        """Give the buffer back; the next `take` allocates a new one."""
        buffer, self._buffer, self.size = self._buffer, None, 0
        if buffer is not None:
            self._session.release(buffer)

"""An opened device: its queue, its buffers, and the times of what ran on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Self
from weakref import WeakValueDictionary, ref

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError, DeviceMemoryError
from ..support.context_manager import ContextManager
from .context import (
    DeviceContext,
    EventTimes,
    Kernel,
    check_process,
    forget_context,
    is_inherited,
    keep_for_ever,
    note_session,
    open_context,
)
from .info import DeviceInfo
from .pocl_linker import explain_missing_linker
from .select import choose_device, find_again, list_devices
from .settings import Settings, find_settings

# A buffer of no bytes is an error in OpenCL; an empty array gets this many.
_SMALLEST_BUFFER_BYTES = 16

# OUT_OF_RESOURCES, EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST, INVALID_CONTEXT and INVALID_COMMAND_QUEUE: after them no
# later command of a context need succeed. NVIDIA's driver gives up on a context in which a kernel failed.
_CONTEXT_IS_LOST = (-5, -14, -34, -36)
# MEM_OBJECT_ALLOCATION_FAILURE, OUT_OF_RESOURCES and OUT_OF_HOST_MEMORY: drivers take memory when a buffer is made, or
# when it is first used.
_OUT_OF_MEMORY = (-4, -5, -6)


@cache
def _buffer_type() -> Any:
    """Return the class of buffers that sessions can refer to weakly, once pyopencl is there.

    Nothing has to be given back, so nothing is lost when Ctrl-C strikes between two steps.
    """
    import pyopencl as cl

    class Buffer(cl.Buffer):
        __slots__ = ("__weakref__",)

    return Buffer


class DeviceSession(ContextManager):
    """One device, opened, for one thread at a time; a context manager.

    A buffer is on the device until nothing refers to it, until `release`, or until the session is closed.

    All sessions of a device share its context and its compiled kernels, see `DeviceContext`. A session that is closed
    in a forked child leaves everything as it is: it belongs to the parent.

    Parameters
    ----------
    device : DeviceInfo, str, int or None
        The device, or what `choose_device` takes.

    Raises
    ------
    DeviceError
        There is no such device, its driver refuses, or this process was forked from one that has used OpenCL.

    Attributes
    ----------
    info : DeviceInfo
    settings : Settings
        How kernels are launched on it.
    shared : DeviceContext
        What all sessions of the device share.
    queue : pyopencl.CommandQueue
    times : EventTimes
        Of all commands of this session and its branches.
    is_closed : bool
        Whether the buffers are gone.
    """

    def __init__(self, device: DeviceInfo | str | int | None = None) -> None:
        info = find_again(device) if isinstance(device, DeviceInfo) else choose_device(device)
        if reason := explain_missing_linker(info.driver_version):
            raise DeviceError(reason)
        self._open(info, find_settings(info), EventTimes(), None)

    @classmethod
    def in_context(cls, context: Any) -> Self:
        """Return a session on the first device of a `pyopencl.Context` that somebody else has made.

        Raises
        ------
        DeviceError
            The driver refuses, or does not list the device.
        """
        info = next((each for each in list_devices() if each.cl_device == context.devices[0]), None)
        if info is None:
            raise DeviceError(f"the device of {context} is none of those that `clbvh devices` lists")
        session = cls.__new__(cls)
        session._open(info, find_settings(info), EventTimes(), open_context(info, context))
        return session

    def branch(self, times: EventTimes | None = None) -> DeviceSession:
        """Return another session on the same device, for another thread; it uses the buffers of this one as well.

        Times are those of this session, or other ones.

        Raises
        ------
        DeviceError
            The driver refuses.
        """
        session = type(self).__new__(type(self))
        # Not whatever context the device has by now: the buffers of this session are in its own.
        session._open(self.info, self.settings, times or self.times, self.shared)
        return session

    def _open(self, info: DeviceInfo, settings: Settings, times: EventTimes, shared: DeviceContext | None) -> None:
        import pyopencl as cl

        self._cl: Any = cl
        self.info = info
        self.settings = settings
        self.times = times
        self.is_closed = False
        # Not their owner: a buffer that Ctrl-C keeps from its place is gone at once.
        self._buffers: set[ref[Any]] = set()
        # Arrays of `hold_mapped` by their identity; whoever refers to one holds its mapping.
        self._held: WeakValueDictionary[int, NDArray[np.uint8]] = WeakValueDictionary()
        self._unfinished = ""  # the kernel whose errors the next wait may report
        with self._errors("be opened"):
            self.shared = shared or open_context(info)
            # It runs its commands one after the other.
            self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        note_session(self)

    @property
    def context(self) -> Any:
        """The `pyopencl.Context` of the device."""
        return self.shared.context

    @property
    def buffer_count(self) -> int:
        """Buffers that are on the device."""
        return len(self._buffers)

    def upload(self, array: NDArray[Any]) -> Any:
        """Copy an array into a new read-only buffer."""
        buffer = self.allocate(array.nbytes, writable=False)
        if array.nbytes:
            self.write(buffer, array)
        return buffer

    def write(self, buffer: Any, array: NDArray[Any], *, begin: int = 0) -> None:
        """Copy an array into an existing buffer, from a byte of it on."""
        with self._errors(f"take {array.nbytes / 1e6:,.1f} MB"):
            event = self._cl.enqueue_copy(
                self.queue, buffer, np.ascontiguousarray(array), dst_offset=begin, is_blocking=True
            )
        self.times.note("upload", event)

    def copy(self, source: Any, target: Any, size: int, *, source_begin: int = 0, target_begin: int = 0) -> None:
        """Copy `size` bytes of a buffer into another one, each from its own byte on."""
        if size > 0:
            with self._errors(f"copy {size / 1e6:,.1f} MB"):
                event = self._cl.enqueue_copy(
                    self.queue, target, source, byte_count=size, src_offset=source_begin, dst_offset=target_begin
                )
            self.times.note("upload", event)

    def allocate(self, size: int, *, writable: bool = True, for_mapping: bool = False) -> Any:
        """Return a new buffer of `size` bytes; `for_mapping` where the host can reach it without a copy.

        Raises
        ------
        DeviceError
            A `DeviceMemoryError`: the size is above the device's largest allocation, or it has no memory for it.
        """
        if size > self.info.max_allocation_bytes:
            largest = f"the largest one it allocates has {self.info.max_allocation_bytes / 1e6:,.1f} MB"
            raise _explain(self.info, f"hold a buffer of {size / 1e6:,.1f} MB", largest, DeviceMemoryError)
        flags = self._cl.mem_flags.READ_WRITE if writable else self._cl.mem_flags.READ_ONLY
        if for_mapping:
            flags |= self._cl.mem_flags.ALLOC_HOST_PTR
        with self._errors(f"hold a buffer of {size / 1e6:,.1f} MB"):
            buffer = _buffer_type()(self.context, flags, max(size, _SMALLEST_BUFFER_BYTES))
        # The callback is no Python code, in which Ctrl-C would be lost.
        self._buffers.add(ref(buffer, self._buffers.discard))
        return buffer

    def make_array(self, shape: tuple[int, ...], dtype: Any, values: NDArray[Any] | None = None) -> Any:
        """Return a `pyopencl.array.Array` with these values, if any, which lives as long as somebody refers to it.

        It is on this session's queue.

        Raises
        ------
        DeviceError
            As of `allocate`.
        """
        import pyopencl.array  # takes 0.1 s, and most processes have no use for it

        with self._errors("hold an array"):
            array = pyopencl.array.empty(self.queue, shape, dtype)
        if values is not None and values.size:
            self.write(array.base_data, values)
        return array

    def fit_items(self, item_bytes: int, wanted: int) -> int:
        """Return how many items of this size one buffer can hold, `wanted` at most and 1 at least."""
        return max(1, min(wanted, self.info.max_allocation_bytes // item_bytes))

    def release(self, buffer: Any) -> None:
        """Give a buffer back although something may refer to it; in a forked child it stays."""
        if is_inherited():
            return
        self._buffers.discard(ref(buffer))
        buffer.release()

    def download(self, buffer: Any, into: NDArray[Any], *, begin: int = 0) -> None:
        """Copy a buffer, from a byte of it on, into a contiguous array, filling it."""
        if into.nbytes:
            with self._errors(f"{self._unfinished}give back {into.nbytes / 1e6:,.1f} MB"):
                event = self._cl.enqueue_copy(self.queue, into, buffer, src_offset=begin, is_blocking=True)
            self._unfinished = ""
            self.times.note("download", event)

    @contextmanager
    def mapped(
        self, buffer: Any, item_count: int, dtype: np.dtype, *, write: bool, first: int = 0
    ) -> Iterator[NDArray[Any]]:
        """Give a part of a buffer as an array, to fill or to read. Nothing is copied on a CPU.

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
        flags = self._cl.map_flags.WRITE_INVALIDATE_REGION if write else self._cl.map_flags.READ
        label = "upload" if write else "download"
        array, event = self._map(buffer, flags, first * dtype.itemsize, item_count * dtype.itemsize)
        self.times.note(label, event)
        try:
            yield array.view(dtype)
        finally:
            if is_inherited():
                keep_for_ever(array)
            else:
                with self._errors("take back what it shared with the host"):
                    self.times.note(label, array.base.release(self.queue))

    def hold_mapped(self, buffer: Any, size: int) -> NDArray[np.uint8]:
        """Return the bytes of a buffer to read, mapped until nothing refers to them, or until the end of the session.

        Kernels may read the buffer meanwhile, but nothing may write to it. Two threads may not map one buffer at once:
        PoCL 3.0 ends the oldest mapping at an address, be it one that another thread has only begun.
        """
        array, _ = self._map(buffer, self._cl.map_flags.READ, 0, size)
        self._held[id(array)] = array
        return array

    def _map(self, buffer: Any, flags: Any, begin: int, size: int) -> tuple[Any, Any]:
        """Return some bytes of a buffer, and the event; as bytes, since PyOpenCL takes no dtype that holds arrays."""
        with self._errors(f"{self._unfinished}share {size / 1e6:,.1f} MB with the host"):
            mapped = self._cl.enqueue_map_buffer(self.queue, buffer, flags, begin, size, np.uint8, is_blocking=True)
        self._unfinished = ""
        return mapped

    def finish(self) -> None:
        """Wait for all commands of this session: sessions on other queues may use what they have written."""
        with self._errors(f"{self._unfinished}finish its work"):
            self.queue.finish()
        self._unfinished = ""

    def run(self, kernel: Kernel, work_size: tuple[int, ...], work_group: tuple[int, ...], **arguments: Any) -> None:
        """Start a kernel once per work-item, after all commands before it; reading its results waits for it.

        Parameters
        ----------
        kernel : Kernel
        work_size : tuple of int
            Work-items per dimension, rounded up to whole work-groups: the kernel checks its range.
        work_group : tuple of int
            Work-items of a work-group per dimension.
        **arguments
            The kernel's arguments by name.
        """
        rounded = tuple(-(-size // edge) * edge for size, edge in zip(work_size, work_group, strict=True))
        bound = kernel.bind(**arguments)
        with self._errors(f"run the kernel '{kernel.name}'"):
            event = kernel.enqueue(self.queue, rounded, work_group, bound)
        self._unfinished = f"finish the kernel '{kernel.name}' and "
        self.times.note("kernel", event)

    def close(self) -> None:
        """Give all buffers back. Closing twice is allowed."""
        self.is_closed = True
        if not is_inherited():
            for array in list(self._held.values()):
                with self._errors("take back what it shared with the host"):
                    array.base.release(self.queue)  # type: ignore[union-attr]
            self._held.clear()
            for buffer in self._list_buffers():
                self.release(buffer)

    def list_handles(self) -> list[Any]:
        """Return all that must outlive a fork; see `note_session`."""
        return [*vars(self).values(), *self._held.values(), *self._list_buffers()]

    def _list_buffers(self) -> list[Any]:
        return [buffer for reference in list(self._buffers) if (buffer := reference()) is not None]

    @contextmanager
    def _errors(self, action: str) -> Iterator[None]:
        """Refuse an action in a forked child, and turn an OpenCL error into a `DeviceError` that names the action."""
        check_process()
        try:
            yield
        except self._cl.Error as error:
            code = getattr(error, "code", None)  # errors that pyopencl finds itself have none
            if code in _CONTEXT_IS_LOST:
                forget_context(getattr(self, "shared", None))  # none while it opens
            kind = DeviceMemoryError if code in _OUT_OF_MEMORY else DeviceError
            raise _explain(self.info, action, error, kind) from error


def _explain(info: DeviceInfo, action: str, reason: object, kind: type[DeviceError] = DeviceError) -> DeviceError:
    """Return the error for something that a device cannot do."""
    return kind(
        f"the device '{info.name}' cannot {action} ({reason}): "
        "try a smaller job or another --device, and see `clbvh doctor`"
    )


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

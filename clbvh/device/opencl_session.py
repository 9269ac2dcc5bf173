"""A device of OpenCL, opened: its queue, its buffers, and the times of what ran on it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError, DeviceMemoryError
from .context import (
    DeviceContext,
    OpenclKernel,
    check_process,
    forget_context,
    is_inherited,
    keep_for_ever,
    note_session,
    open_context,
)
from .info import DeviceInfo
from .pocl_3 import prepare_pocl_3
from .program import compile_kernels
from .select import list_devices
from .session import DeviceSession
from .times import CommandTimes

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


class OpenclSession(DeviceSession):
    """A device of OpenCL; see `DeviceSession`.

    All sessions of a device share its context and its compiled kernels, see `DeviceContext`. A session that is closed
    in a forked child leaves everything as it is: it belongs to the parent.

    Attributes
    ----------
    shared : DeviceContext
        Context and kernels, which all sessions of the device share.
    queue : pyopencl.CommandQueue
    """

    def __init__(
        self,
        info: DeviceInfo,
        parent: OpenclSession | None = None,
        times: CommandTimes | None = None,
        shared: DeviceContext | None = None,
    ) -> None:
        import pyopencl as cl

        super().__init__(info, parent, times)
        prepare_pocl_3(info)
        self._cl: Any = cl
        self._unfinished = ""  # the kernel whose errors the next wait may report
        with self._errors("be opened"):
            self.shared = shared or open_context(info)
            self.context = self.shared.context
            # It runs its commands one after the other.
            self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        note_session(self)

    @classmethod
    def in_context(cls, context: Any) -> OpenclSession:
        """Return a session on the first device of a `pyopencl.Context` that somebody else has made.

        Raises
        ------
        DeviceError
            The driver refuses, or does not list the device.
        """
        info = next((each for each in list_devices() if each.cl_device == context.devices[0]), None)
        if info is None:
            raise DeviceError(f"the device of {context} is none of those that `clbvh devices` lists")
        return cls(info, shared=open_context(info, context))

    def branch(self, times: CommandTimes | None = None) -> OpenclSession:
        """See `DeviceSession`."""
        # The context of this session's buffers; the device may have another one by now.
        return type(self)(self.info, self, times, self.shared)

    def kernels(
        self, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None
    ) -> Mapping[str, OpenclKernel]:
        """See `DeviceSession`; compiled by the driver, once in a process."""
        check_process()
        return compile_kernels(self.shared, self.info, name, defines or {}, folder)

    def write(self, buffer: Any, array: NDArray[Any], *, begin: int = 0) -> None:
        """See `DeviceSession`."""
        with self._errors(f"take {array.nbytes / 1e6:,.1f} MB"):
            event = self._cl.enqueue_copy(
                self.queue, buffer, np.ascontiguousarray(array), dst_offset=begin, is_blocking=True
            )
        self.times.note("upload", event)

    def copy(self, source: Any, target: Any, size: int, *, source_begin: int = 0, target_begin: int = 0) -> None:
        """See `DeviceSession`."""
        if size > 0:
            with self._errors(f"copy {size / 1e6:,.1f} MB"):
                event = self._cl.enqueue_copy(
                    self.queue, target, source, byte_count=size, src_offset=source_begin, dst_offset=target_begin
                )
            self.times.note("upload", event)

    def allocate(self, size: int, *, writable: bool = True, for_mapping: bool = False) -> Any:
        """See `DeviceSession`."""
        if size > self.info.max_allocation_bytes:
            largest = f"the largest one it allocates has {self.info.max_allocation_bytes / 1e6:,.1f} MB"
            raise _explain(self.info, f"hold a buffer of {size / 1e6:,.1f} MB", largest, DeviceMemoryError)
        flags = self._cl.mem_flags.READ_WRITE if writable else self._cl.mem_flags.READ_ONLY
        if for_mapping:
            flags |= self._cl.mem_flags.ALLOC_HOST_PTR
        with self._errors(f"hold a buffer of {size / 1e6:,.1f} MB"):
            buffer = _buffer_type()(self.context, flags, max(size, _SMALLEST_BUFFER_BYTES))
        self._note(buffer)
        return buffer

    def make_array(self, shape: tuple[int, ...], dtype: Any, values: NDArray[Any] | None = None) -> Any:
        """See `DeviceSession`; a `pyopencl.array.Array` on this session's queue."""
        import pyopencl.array  # takes 0.1 s, and most processes have no use for it

        with self._errors("hold an array"):
            array = pyopencl.array.empty(self.queue, shape, dtype)
        if values is not None and values.size:
            self.write(array.base_data, values)
        return array

    def memory_of(self, array: Any) -> Any:
        """See `DeviceSession`."""
        return array.base_data

    def release(self, buffer: Any) -> None:
        """See `DeviceSession`; in a forked child it stays."""
        if is_inherited():
            return
        self._forget(buffer)
        buffer.release()

    def download(self, buffer: Any, into: NDArray[Any], *, begin: int = 0) -> None:
        """See `DeviceSession`."""
        if into.nbytes:
            with self._errors(f"{self._unfinished}give back {into.nbytes / 1e6:,.1f} MB"):
                event = self._cl.enqueue_copy(self.queue, into, buffer, src_offset=begin, is_blocking=True)
            self._unfinished = ""
            self.times.note("download", event)

    @contextmanager
    def mapped(
        self, buffer: Any, item_count: int, dtype: np.dtype, *, write: bool, first: int = 0
    ) -> Iterator[NDArray[Any]]:
        """See `DeviceSession`; nothing is copied on a CPU."""
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

    def _map(self, buffer: Any, flags: Any, begin: int, size: int) -> tuple[Any, Any]:
        """Return some bytes of a buffer, and the event; as bytes, since PyOpenCL takes no dtype that holds arrays."""
        with self._errors(f"{self._unfinished}share {size / 1e6:,.1f} MB with the host"):
            mapped = self._cl.enqueue_map_buffer(self.queue, buffer, flags, begin, size, np.uint8, is_blocking=True)
        self._unfinished = ""
        return mapped

    def finish(self) -> None:
        """See `DeviceSession`."""
        with self._errors(f"{self._unfinished}finish its work"):
            self.queue.finish()
        self._unfinished = ""

    def run(
        self, kernel: OpenclKernel, work_size: tuple[int, ...], work_group: tuple[int, ...], **arguments: Any
    ) -> None:
        """See `DeviceSession`; reading its results waits for it."""
        rounded = tuple(-(-size // edge) * edge for size, edge in zip(work_size, work_group, strict=True))
        bound = kernel.in_order(arguments)
        with self._errors(f"run the kernel '{kernel.name}'"):
            event = kernel.enqueue(self.queue, rounded, work_group, bound)
        self._unfinished = f"finish the kernel '{kernel.name}' and "
        self.times.note("kernel", event)

    def check_process(self) -> None:
        """See `DeviceSession`."""
        check_process()

    def list_handles(self) -> list[Any]:
        """Return all that must outlive a fork; see `note_session`."""
        return [*vars(self).values(), *self._list_buffers()]

    @contextmanager
    def _errors(self, action: str) -> Iterator[None]:
        """Refuse an action in a forked child, and turn an OpenCL error into a `DeviceError` that names the action."""
        check_process()
        try:
            yield
        except self._cl.Error as error:
            code = getattr(error, "code", None)  # errors that pyopencl finds itself have none
            if code in _CONTEXT_IS_LOST:
                forget_context(getattr(self, "shared", None))  # missing while it opens
            kind = DeviceMemoryError if code in _OUT_OF_MEMORY else DeviceError
            raise _explain(self.info, action, error, kind) from error


def _explain(info: DeviceInfo, action: str, reason: object, kind: type[DeviceError] = DeviceError) -> DeviceError:
    """Return the error for something that a device cannot do."""
    return kind(
        f"the device '{info.name}' cannot {action} ({reason}): "
        "try a smaller job or another --device, and see `clbvh doctor`"
    )

"""An opened device: its context, its queue, its buffers, and the times of what ran on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..closing import Closing
from ..errors import DeviceError
from .select import DeviceInfo, choose_device
from .timing import EventTimes

# A buffer of no bytes is an error in OpenCL; an empty array gets this many.
_SMALLEST_BUFFER_BYTES = 16


class DeviceSession(Closing):
    """One device, opened; a context manager.

    Parameters
    ----------
    device : DeviceInfo, str, int or None
        The device, or what `choose_device` takes.

    Raises
    ------
    DeviceError
        There is no such device, or its driver refuses.

    Attributes
    ----------
    info : DeviceInfo
    context, queue : pyopencl.Context, pyopencl.CommandQueue
    times : EventTimes
        Of everything that went through this session.
    is_closed : bool
        Whether the buffers are gone.
    """

    def __init__(self, device: DeviceInfo | str | int | None = None) -> None:
        self.info = device if isinstance(device, DeviceInfo) else choose_device(device)
        import pyopencl as cl

        self._cl: Any = cl
        self.is_closed = False
        self.times = EventTimes()
        self._buffers: list[Any] = []
        self._unfinished = ""  # what else an error of the next wait may come from
        with self._errors("be opened"):
            self.context = cl.Context([self.info.cl_device])
            self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)

    def upload(self, array: NDArray[Any]) -> Any:
        """Copy an array into a new read-only buffer."""
        buffer = self.allocate(array.nbytes, writable=False)
        if array.nbytes:
            self.write(buffer, array)
        return buffer

    def write(self, buffer: Any, array: NDArray[Any]) -> None:
        """Copy an array into a buffer that exists."""
        with self._errors(f"take {array.nbytes / 1e6:,.1f} MB"):
            event = self._cl.enqueue_copy(self.queue, buffer, np.ascontiguousarray(array), is_blocking=True)
        self.times.note("upload", event)

    def allocate(self, size: int, *, writable: bool = True, for_mapping: bool = False) -> Any:
        """Return a new buffer of `size` bytes; `for_mapping` where the host can reach it without a copy."""
        flags = self._cl.mem_flags.READ_WRITE if writable else self._cl.mem_flags.READ_ONLY
        if for_mapping:
            flags |= self._cl.mem_flags.ALLOC_HOST_PTR
        with self._errors(f"hold a buffer of {size / 1e6:,.1f} MB"):
            buffer = self._cl.Buffer(self.context, flags, max(size, _SMALLEST_BUFFER_BYTES))
        self._buffers.append(buffer)
        return buffer

    def release(self, buffer: Any) -> None:
        """Give a buffer back before the session ends."""
        self._buffers.remove(buffer)
        buffer.release()

    def download(self, buffer: Any, into: NDArray[Any]) -> None:
        """Copy the beginning of a buffer into a contiguous array, filling it."""
        if into.nbytes:
            with self._errors(f"{self._unfinished}give back {into.nbytes / 1e6:,.1f} MB"):
                event = self._cl.enqueue_copy(self.queue, into, buffer, is_blocking=True)
            self._unfinished = ""
            self.times.note("download", event)

    @contextmanager
    def mapped(self, buffer: Any, row_count: int, dtype: np.dtype, *, write: bool) -> Iterator[NDArray[Any]]:
        """Give the beginning of a buffer as an array: to be filled, or else to be read. Nothing is copied on a CPU.

        Parameters
        ----------
        buffer : buffer
        row_count : int
            At least 1.
        dtype : numpy.dtype
        write : bool
            Whether the array is to be filled, all of it; otherwise it must not be written to.
        """
        flags = self._cl.map_flags.WRITE_INVALIDATE_REGION if write else self._cl.map_flags.READ
        label = "upload" if write else "download"
        with self._errors(f"{self._unfinished}share {row_count * dtype.itemsize / 1e6:,.1f} MB with the host"):
            # As bytes: PyOpenCL takes no dtype that holds arrays.
            array, event = self._cl.enqueue_map_buffer(
                self.queue, buffer, flags, 0, row_count * dtype.itemsize, np.uint8, is_blocking=True
            )
        self._unfinished = ""
        self.times.note(label, event)
        try:
            yield array.view(dtype)
        finally:
            with self._errors("take back what it shared with the host"):
                self.times.note(label, array.base.release(self.queue))

    def run(self, kernel: Any, work_size: tuple[int, ...], group_size: tuple[int, ...], *arguments: Any) -> None:
        """Start a kernel once per work-item, behind all that was asked before. What reads its results waits for it.

        Parameters
        ----------
        work_size : tuple of int
            Work-items per dimension, rounded up to whole groups: the kernel checks its range.
        group_size : tuple of int
            Work-items of a work-group per dimension.
        """
        rounded = tuple(-(-size // group) * group for size, group in zip(work_size, group_size, strict=True))
        with self._errors(f"run the kernel '{kernel.function_name}'"):
            event = kernel(self.queue, rounded, group_size, *arguments)
        self._unfinished = f"finish the kernel '{kernel.function_name}' and "
        self.times.note("kernel", event)

    def close(self) -> None:
        """Give all buffers back. Closing twice is allowed."""
        self.is_closed = True
        while self._buffers:
            self._buffers.pop().release()

    def _errors(self, action: str) -> _DeviceErrors:
        return _DeviceErrors(self._cl, self.info, action)


class _DeviceErrors:
    """Turn an OpenCL error into a `DeviceError` that says what the device could not do."""

    def __init__(self, cl: Any, info: DeviceInfo, action: str) -> None:
        self._cl = cl
        self._info = info
        self._action = action

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, self._cl.Error):
            raise DeviceError(
                f"the device '{self._info.name}' cannot {self._action} ({error}): "
                "try a smaller job or another --device, and see `clbvh doctor`"
            ) from error

"""The host, opened as a device: buffers are its own memory, and its threads run the kernels."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DeviceMemoryError, InternalError
from ...support.memory import check_memory
from ..info import DeviceInfo
from ..session import DeviceSession
from ..sources import expand_source
from ..times import CommandTimes
from .library import HostBuffer, HostKernel, HostLibrary, open_library

# Bytes of a vector register and of a cache line.
_ALIGNMENT = 64

# Bands of work-groups for each thread. Ctrl-C is heard between two of them.
_BANDS = 16

# Least work-groups of a band, where groups have many items, or an item does the work of many: to wake a thread takes as
# long as half of them.
LEAST_GROUPS = 16
_MANY_ITEMS = 16

_MS_PER_S = 1e3


class HostSession(DeviceSession):
    """The host as a device; see `DeviceSession`.

    It works in a forked child, and no buffer is too large for it.
    """

    _library: HostLibrary

    def __init__(
        self,
        info: DeviceInfo,
        parent: HostSession | None = None,
        times: CommandTimes | None = None,
        thread_count: int | None = None,
    ) -> None:
        super().__init__(info, parent, times, thread_count)
        self._library = open_library() if parent is None else parent._library

    def branch(self, times: CommandTimes | None = None) -> HostSession:
        """See `DeviceSession`."""
        return type(self)(self.info, self, times)

    def kernels(
        self, name: str, defines: Mapping[str, int] | None = None, *, folder: Path | None = None
    ) -> Mapping[str, HostKernel]:
        """See `DeviceSession`; compiled ahead of time, and those of another folder now."""
        if folder is not None:
            return self._library.compile(expand_source(f"kernels/{name}.cl", folder), defines or {})
        return self._library.kernels(name, defines or {})

    def allocate(self, size: int, *, writable: bool = True, for_mapping: bool = False) -> HostBuffer:
        """See `DeviceSession`."""
        buffer = HostBuffer(self._make_bytes(size))
        self._note(buffer)
        return buffer

    def _make_bytes(self, size: int) -> NDArray[np.uint8]:
        check_memory(f"a buffer of the device '{self.info.name}'", size, DeviceMemoryError, "try a smaller job")
        try:
            memory = np.empty(size + _ALIGNMENT, np.uint8)
        except MemoryError as error:
            raise DeviceMemoryError(f"the device '{self.info.name}' has no memory left: {error}") from None
        begin = -memory.ctypes.data % _ALIGNMENT
        return memory[begin : begin + size]

    def make_array(self, shape: tuple[int, ...], dtype: Any, values: NDArray[Any] | None = None) -> NDArray[Any]:
        """See `DeviceSession`; a numpy array."""
        item = np.dtype(dtype)
        array = self._make_bytes(int(np.prod(shape)) * item.itemsize).view(item).reshape(shape)
        if values is not None:
            array[...] = values
        return array

    def memory_of(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `DeviceSession`."""
        return array

    def release(self, buffer: HostBuffer) -> None:
        """See `DeviceSession`."""
        self._forget(buffer)
        buffer.array = buffer.address = None

    def write(self, buffer: HostBuffer, array: NDArray[Any], *, begin: int = 0) -> None:
        """See `DeviceSession`."""
        if array.nbytes:
            self._move("upload", _part(buffer, begin, array.nbytes), _bytes_of(np.ascontiguousarray(array)))

    def copy(
        self, source: HostBuffer, target: HostBuffer, size: int, *, source_begin: int = 0, target_begin: int = 0
    ) -> None:
        """See `DeviceSession`."""
        if size > 0:
            self._move("upload", _part(target, target_begin, size), _part(source, source_begin, size))

    def download(self, buffer: HostBuffer, into: NDArray[Any], *, begin: int = 0) -> None:
        """See `DeviceSession`."""
        if into.nbytes:
            self._move("download", _bytes_of(into), _part(buffer, begin, into.nbytes))

    def _move(self, label: str, target: NDArray[np.uint8], source: NDArray[np.uint8]) -> None:
        begin_s = time.perf_counter()
        target[:] = source
        self.times.add(label, (time.perf_counter() - begin_s) * _MS_PER_S)

    def mapped(
        self, buffer: HostBuffer, item_count: int, dtype: np.dtype, *, write: bool, first: int = 0
    ) -> AbstractContextManager[NDArray[Any]]:
        """See `DeviceSession`; a view."""
        # Not by `view`, which takes 2 us for structs.
        return nullcontext(np.ndarray((item_count,), dtype, _bytes_of(buffer), first * dtype.itemsize))

    def finish(self) -> None:
        """See `DeviceSession`; everything is done."""

    def run(
        self, kernel: HostKernel, work_size: tuple[int, ...], work_group: tuple[int, ...], **arguments: Any
    ) -> None:
        """See `DeviceSession`; returns when all work-items are done."""
        columns, group_columns = work_size[0], work_group[0]
        rows, group_rows = (work_size[1], work_group[1]) if len(work_size) > 1 else (1, 1)
        shape = -(-columns // group_columns), -(-rows // group_rows), group_columns, group_rows
        # The kernel has addresses alone. Whoever gives a buffer back meanwhile, its memory stays until the last band.
        used = [each.array for each in arguments.values() if each.__class__ is HostBuffer], kernel.hold()
        least = LEAST_GROUPS if group_columns * group_rows >= _MANY_ITEMS else 1
        self.run_groups(kernel.entry, kernel.bind(shape, arguments), shape[0] * shape[1], least, used)

    def run_groups(self, entry: Any, launch: bytes, group_count: int, least: int, used: Any) -> None:
        """Run work-groups of a kernel, in bands of `least` or more; what is used stays until they are done."""
        begin_s = time.perf_counter()
        if group_count < 2 * least:
            entry(launch, 0, group_count)
        else:
            self._run_bands(entry, launch, group_count, least, used)
        self.times.add("kernel", (time.perf_counter() - begin_s) * _MS_PER_S)

    def _run_bands(self, entry: Any, launch: bytes, group_count: int, least: int, used: Any) -> None:
        thread_count = min(self.threads.count, group_count // least)
        size = max(least, -(-group_count // (_BANDS * thread_count)))
        # The next band, from any thread: `next` of a counter is one step of the interpreter.
        begins = count(0, size)
        is_stopped: list[bool] = []

        def run_bands(_used: Any = used) -> None:
            try:
                while not is_stopped and (begin := next(begins)) < group_count:
                    entry(launch, begin, min(begin + size, group_count))
            except BaseException:  # Ctrl-C: the other threads must not do the rest
                is_stopped.append(True)
                raise

        self.threads.run(run_bands, [()] * thread_count)

    def check_process(self) -> None:
        """See `DeviceSession`; nothing is refused."""


def _part(buffer: Any, begin: int, size: int) -> NDArray[np.uint8]:
    """Return some bytes of a buffer, or of an array of `make_array`."""
    return _bytes_of(buffer)[begin : begin + size]


def _bytes_of(memory: Any) -> NDArray[np.uint8]:
    """Return the bytes of a buffer or an array."""
    if memory.__class__ is HostBuffer:
        if memory.array is None:
            raise InternalError("a buffer of the host was given back, and is used")
        return memory.array
    if not memory.flags.c_contiguous:
        raise InternalError("an array that is not contiguous is copied to or from the host device")
    return memory.reshape(-1).view(np.uint8)

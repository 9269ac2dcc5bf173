"""Shared memory with one owner.

The coordinator creates every array and frees it; workers attach by a handle. On Linux the memory is anonymous
(`memfd_create`): it has no name that could be left behind, whatever kills the process, and it does not count
against a container's small `/dev/shm`. When the machine's memory does not suffice, and on other systems, a mapped
temporary file takes its place.
"""

from __future__ import annotations

import itertools
import mmap
import os
import shutil
import tempfile
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...errors import PoolError
from ...support.context_manager import ContextManager
from ...support.memory import free_memory_bytes

_OWN_FILES = Path("/proc/self/fd")

# A path alone does not name an array: the number of a closed descriptor is given to the next file.
_serials = itertools.count()


@dataclass(frozen=True)
class ArrayHandle:
    """A shared array, as a worker attaches to it.

    Attributes
    ----------
    path : str
        The memory's file.
    size : int
        Its bytes; the array may be smaller.
    serial : int
        The memory's number: no other in this process has it.
    shape : tuple of int
    dtype : numpy.dtype
    """

    path: str
    size: int
    serial: int
    shape: tuple[int, ...]
    dtype: np.dtype

    def attach(self) -> NDArray[Any]:
        """Map the array into this process; the mapping ends with the last reference to the array."""
        return self.view(self.map())

    def map(self) -> mmap.mmap:
        """Map the memory into this process."""
        with open(self.path, "r+b", buffering=0) as file:  # noqa: PTH123 - Path.open adds nothing here
            return mmap.mmap(file.fileno(), self.size)

    def view(self, memory: Any) -> NDArray[Any]:
        """Return the array that lies in the mapped memory."""
        return np.frombuffer(memory, self.dtype, prod(self.shape)).reshape(self.shape)

    def reshape(self, shape: tuple[int, ...], dtype: DTypeLike) -> ArrayHandle:
        """Return a handle of another array in the same memory."""
        return replace(self, shape=shape, dtype=np.dtype(dtype))


class Arena(ContextManager):
    """Owner of the shared arrays of one build; a context manager that frees them all.

    An array that `create` returned stays valid after the arena is closed, for as long as it is referenced: the arena
    gives up its own hold on the memory, and others can no longer attach.
    """

    def __init__(self) -> None:
        self._files: dict[str, int] = {}
        self._names: list[Path] = []
        # Memory is taken when it is first written to, so the system still counts promised memory as free. To ask how
        # much is free takes 0.5 ms, which a build saves that finds all its memory in the workspace.
        self._free_bytes: int | None = None
        self._promised_bytes: dict[str, int] = {}

    def create(self, shape: tuple[int, ...], dtype: DTypeLike) -> tuple[ArrayHandle, NDArray[Any]]:
        """Create an array of zeros, and the handle that attaches workers to it.

        Raises
        ------
        PoolError
            Neither memory nor the disk of the temporary folder has enough free space.
        """
        dtype = np.dtype(dtype)
        size = prod(shape) * dtype.itemsize
        descriptor, path = self._create_file(size)
        self._files[path] = descriptor
        handle = ArrayHandle(path, size, next(_serials), shape, dtype)
        return handle, handle.attach()

    def share(self, array: NDArray[Any]) -> ArrayHandle:
        """Copy an array into shared memory and return the handle of the copy."""
        handle, copy = self.create(array.shape, array.dtype)
        copy[...] = array
        return handle

    def free(self, handle: ArrayHandle) -> None:
        """Give up one array; its memory goes back when the last process that attached lets go of it."""
        os.close(self._files.pop(handle.path))
        self._promised_bytes.pop(handle.path, None)

    def close(self) -> None:
        """Give up all arrays. Closing twice is allowed."""
        while self._files:
            os.close(self._files.popitem()[1])
        self._promised_bytes.clear()
        while self._names:
            self._names.pop().unlink(missing_ok=True)

    def _create_file(self, size: int) -> tuple[int, str]:
        """Return an open file of `size` bytes and a path by which workers can open it."""
        if self._free_bytes is None:
            self._free_bytes = free_memory_bytes()
        promised = sum(self._promised_bytes.values())
        fits = size <= min(free_memory_bytes(), self._free_bytes - promised)
        if fits and hasattr(os, "memfd_create") and _OWN_FILES.is_dir():
            descriptor = os.memfd_create("clbvh")
            os.ftruncate(descriptor, size)
            path = f"/proc/{os.getpid()}/fd/{descriptor}"
            self._promised_bytes[path] = size
            return descriptor, path

        folder = tempfile.gettempdir()
        if size > shutil.disk_usage(folder).free:
            raise _no_space(size, folder)
        if _OWN_FILES.is_dir():
            # A file without a name, where the file system supports that: nothing can be left behind.
            with tempfile.TemporaryFile(prefix="clbvh-", dir=folder) as file:
                descriptor = os.dup(file.fileno())
            path = f"/proc/{os.getpid()}/fd/{descriptor}"
        else:
            descriptor, path = tempfile.mkstemp(prefix="clbvh-", dir=folder)
            self._names.append(Path(path))
        try:
            # Reserve the blocks now: a disk that fills up later would kill the process at a plain store (SIGBUS).
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(descriptor, 0, size)
            else:
                os.ftruncate(descriptor, size)
        except OSError as error:
            os.close(descriptor)
            raise _no_space(size, folder) from error
        return descriptor, path


def _no_space(size: int, folder: str) -> PoolError:
    """Return the error for an array that fits neither the memory nor the temporary folder."""
    free = shutil.disk_usage(folder).free
    return PoolError(
        f"the build needs {size / 1e6:,.0f} MB to share with its workers, but there are "
        f"{free_memory_bytes() / 1e6:,.0f} MB of memory and {free / 1e6:,.0f} MB in {folder}: "
        "free some, set TMPDIR to a larger disk, or build without a pool"
    )

"""Arrays that several processes see.

On Linux the memory is anonymous (`memfd_create`): it has no name that could be left behind, whatever kills the process,
and it does not count against a container's small `/dev/shm`. On other systems it is a mapped temporary file.
"""

from __future__ import annotations

import itertools
import mmap
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...errors import PoolError
from ...support.memory import free_memory_bytes

_HAS_ANONYMOUS_FILES = hasattr(os, "memfd_create") and Path("/proc/self/fd").is_dir()

# A path alone does not name an array: the number of a closed descriptor is given to the next file.
_serials = itertools.count()


@dataclass(frozen=True)
class ArrayHandle:
    """A shared array, as another process attaches to it.

    Attributes
    ----------
    path : str
        The file of its memory.
    serial : int
        No other array of the process that created it has this number.
    shape : tuple of int
    dtype : numpy.dtype
    """

    path: str
    serial: int
    shape: tuple[int, ...]
    dtype: np.dtype

    def attach(self) -> NDArray[Any]:
        """Map the array into this process; the mapping ends with the last reference to the array."""
        size = prod(self.shape) * self.dtype.itemsize
        with open(self.path, "r+b", buffering=0) as file:  # noqa: PTH123 - Path.open adds nothing here
            memory = mmap.mmap(file.fileno(), size)
        return np.frombuffer(memory, self.dtype).reshape(self.shape)


class SharedArray:
    """A shared array of arbitrary contents and its file, which are others' to attach to until it is closed.

    Attributes
    ----------
    handle : ArrayHandle
    array : numpy.ndarray
        Stays valid after closing, for as long as it is referenced.

    Raises
    ------
    PoolError
        There is not enough memory, or not enough space for a temporary file.
    """

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        dtype = np.dtype(dtype)
        size = prod(shape) * dtype.itemsize
        # Asked before: a store to memory that the system does not have would kill the process.
        free = free_memory_bytes() if _HAS_ANONYMOUS_FILES else shutil.disk_usage(tempfile.gettempdir()).free
        if size > free:
            where = "memory" if _HAS_ANONYMOUS_FILES else tempfile.gettempdir()
            raise PoolError(
                f"the build needs {size / 1e6:,.0f} MB to share with its workers, but there are {free / 1e6:,.0f} MB "
                f"in {where}: free some, or build without a pool"
            )
        if _HAS_ANONYMOUS_FILES:
            self._descriptor = os.memfd_create("clbvh")
            path = f"/proc/{os.getpid()}/fd/{self._descriptor}"
        else:
            self._descriptor, path = tempfile.mkstemp(prefix="clbvh-")
        try:
            os.ftruncate(self._descriptor, size)
            self.handle = ArrayHandle(path, next(_serials), shape, dtype)
            self.array = self.handle.attach()
        except BaseException:
            self._close_file(path)
            raise

    def close(self) -> None:
        """Give up the file; others can no longer attach."""
        self._close_file(self.handle.path)

    def _close_file(self, path: str) -> None:
        os.close(self._descriptor)
        if not _HAS_ANONYMOUS_FILES:
            with suppress(OSError):  # Windows keeps a file that is mapped
                Path(path).unlink()

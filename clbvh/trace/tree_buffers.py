"""The buffers of one copy of a tree on a device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.session import DeviceSession
from ..layouts.device_arrays import DeviceArrays

# The arrays of a tree, by the names of the kernels' arguments.
_NAMES = ("nodes", "blocks")


class TreeBuffers:
    """The nodes and the blocks of a tree, each in a buffer.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    arrays : DeviceArrays

    Attributes
    ----------
    arguments : dict of str to buffer
        By the names of the kernels' arguments.
    """

    def __init__(self, session: DeviceSession, arrays: DeviceArrays) -> None:
        self._session = session
        by_name: dict[str, NDArray[np.void]] = {name: getattr(arrays, name) for name in _NAMES}
        self._shapes = {name: (len(array), array.dtype) for name, array in by_name.items()}
        self.arguments: dict[str, Any] = {name: session.upload(array) for name, array in by_name.items()}
        self._held: list[NDArray[np.uint8]] = []

    def twin(self) -> TreeBuffers:
        """Return buffers of the same sizes, which are not allocated yet."""
        twin = TreeBuffers.__new__(TreeBuffers)
        twin._session, twin._shapes, twin.arguments, twin._held = self._session, self._shapes, {}, []
        return twin

    def hold(self) -> list[NDArray[np.uint8]]:
        """Return the bytes of nodes and blocks to read, until the buffers are written or released; neither is empty."""
        self._held = [self._session.hold_mapped(self.arguments[name], self._byte_count(name)) for name in _NAMES]
        return self._held

    def _let_go(self) -> None:
        while self._held:
            self._session.end_mapping(self._held.pop())

    def allocate(self) -> None:
        """Allocate the buffers that are missing.

        Raises
        ------
        DeviceError
            The device has no room for them; then there are none.
        """
        try:
            for name in self._shapes.keys() - self.arguments.keys():
                self.arguments[name] = self._session.allocate(self._byte_count(name), writable=False)
        except BaseException:
            self.release()
            raise

    @property
    def byte_count(self) -> int:
        """Bytes of the buffers that are on the device."""
        return sum(map(self._byte_count, list(self.arguments)))

    def _byte_count(self, name: str) -> int:
        count, dtype = self._shapes[name]
        return count * dtype.itemsize

    @contextmanager
    def mapped(self, session: DeviceSession, *, write: bool) -> Iterator[tuple[NDArray[np.void], NDArray[np.void]]]:
        """Map nodes and blocks into the host's memory as arrays; neither may be empty.

        Parameters
        ----------
        session : DeviceSession
            The one that owns the buffers, or a branch of it.
        write : bool
            True: the caller fills both arrays completely. False: the caller only reads them.
        """
        if write:
            self._let_go()
        nodes, blocks = (session.mapped(self.arguments[name], *self._shapes[name], write=write) for name in _NAMES)
        with nodes as node_array, blocks as block_array:
            yield node_array, block_array

    def release(self) -> None:
        """Give the buffers back before the session ends."""
        self._let_go()
        while self.arguments:
            self._session.release(self.arguments.popitem()[1])

"""Where the rays of each tile enter the tree: found on the device before rays are traced, see cl/entry.cl."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..device.kept_buffer import KeptBuffer
from ..device.program import build_kernels
from ..device.session import DeviceSession
from .device_tree import DeviceTree

# Tiles of a work-group.
_GROUP = (16, 1)


def open_tile_entries(session: DeviceSession, tree: DeviceTree) -> TileEntries:
    """Return what finds the entries of rays in memory."""
    kernels = build_kernels(session, "tile_entries", tree.defines) if tree.entry_bytes else {}
    return TileEntries(session, tree, kernels.get("tile_entries"))


class TileEntries:
    """The entries of the tiles of one launch, in a buffer that is kept for the next one.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree
        In the same session.
    kernel : kernel or None
        The one that finds them; None in a layout without entries, where all rays begin at the root.
    """

    def __init__(self, session: DeviceSession, tree: DeviceTree, kernel: Any | None) -> None:
        self._session = session
        self._tree = tree
        self._kernel = kernel
        self._buffer = KeptBuffer(session)

    def find(self, size: tuple[int, int], tile: tuple[int, int], *arguments: Any) -> Any | None:
        """Return the buffer of entries, as kernels take it; None where there are none.

        Parameters
        ----------
        size : (int, int)
            Columns and rows of the work-items that trace the rays.
        tile : (int, int)
            Their work-groups.
        *arguments
            What the kernel takes between the nodes and the tile.
        """
        if self._kernel is None:
            return None
        columns, rows = (-(-length // edge) for length, edge in zip(size, tile, strict=True))
        entries = self._buffer.take(columns * rows * self._tree.entry_bytes)
        nodes = self._tree.arguments[0]
        self._session.run(self._kernel, (columns, rows), _GROUP, nodes, *arguments, *map(np.int32, tile), entries)
        return entries

    def release(self) -> None:
        """Give the buffer back; the next launch takes a new one."""
        self._buffer.release()

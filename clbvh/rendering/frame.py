"""One picture on the device: band by band, so that its size is bounded by the host's memory only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.program import build_kernels
from ..device.session import DeviceSession
from ..device.settings import find_settings
from ..layout import HIT
from ..trace.device_tree import DeviceTree
from ..trace.entries import TileEntries

# Pixels per kernel launch: 320 MiB of colours and hits on the device. A 4K picture is one launch.
BAND_PIXELS = 2**24

_CHANNELS = 4


class FrameRenderer:
    """Renders pictures of one tree.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree
        In the same session.
    tile : (int, int), optional
        Columns and rows of a work-group; what suits the device without it.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses the kernel.
    """

    def __init__(self, session: DeviceSession, tree: DeviceTree, tile: tuple[int, int] | None = None) -> None:
        self._session = session
        self._tree = tree
        self._tile = find_settings(session.info).tile if tile is None else tile
        kernels = build_kernels(session, "render", tree.defines)
        self._kernel = kernels["render"]
        self._entries = TileEntries(session, tree, kernels.get("view_entries"))

    def render(self, view: NDArray[np.void]) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Return the colours and the hits of one view.

        Parameters
        ----------
        view : (1,) `layout.VIEW`

        Returns
        -------
        colours : (height, width, 4) uint8
            Red, green, blue, and 255 where something is hit.
        hits : (height, width) `layout.HIT`
        """
        session = self._session
        width, height = int(view["width"][0]), int(view["height"][0])
        colours = np.empty((height, width, _CHANNELS), np.uint8)
        hits = np.empty((height, width), HIT)
        band_rows = min(height, max(1, BAND_PIXELS // width))
        view_buffer = session.upload(view)
        colour_buffer = session.allocate(band_rows * width * _CHANNELS)
        hit_buffer = session.allocate(band_rows * width * HIT.itemsize)
        try:
            for first_row in range(0, height, band_rows):
                row_count = min(band_rows, height - first_row)
                size, rows = (width, row_count), (np.int32(first_row), np.int32(row_count))
                entries = self._entries.find(size, self._tile, view_buffer, *rows)
                session.run(
                    self._kernel, size, self._tile,
                    *self._tree.arguments, entries, view_buffer, *rows, colour_buffer, hit_buffer,
                )  # fmt: skip
                session.download(colour_buffer, colours[first_row : first_row + row_count])
                session.download(hit_buffer, hits[first_row : first_row + row_count])
        finally:
            self._entries.release()
            for buffer in (view_buffer, colour_buffer, hit_buffer):
                session.release(buffer)
        return colours, hits

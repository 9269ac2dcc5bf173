"""One picture on the device, band by band, so that only the host's memory bounds its size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.program import build_kernels
from ..device.reusable_buffer import ReusableBuffer
from ..device.session import DeviceSession
from ..errors import DeviceMemoryError
from ..structs import HIT
from ..trace.device_tree import DeviceTree
from ..trace.rays.entry_points import find_entry_points

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
        self._tile = tile or session.settings.tile
        kernels = build_kernels(session, "render", tree.defines)
        self._kernel = kernels["render"]
        # Absent in a layout without entry points.
        self._entry_point_kernel = kernels.get("view_entry_points")

    def render(self, view: NDArray[np.void]) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Return the colours and the hits of one view.

        Parameters
        ----------
        view : (1,) `structs.VIEW`

        Returns
        -------
        colours : (height, width, 4) uint8
            Red, green, blue, and 255 where something is hit.
        hits : (height, width) `structs.HIT`
        """
        width, height = int(view["width"][0]), int(view["height"][0])
        colours = np.empty((height, width, _CHANNELS), np.uint8)
        hits = np.empty((height, width), HIT)
        band_pixels = self._session.fit_items(HIT.itemsize, BAND_PIXELS)
        band_rows = min(height, max(1, band_pixels // width))
        while True:
            try:
                self._render_bands(view, band_rows, colours, hits)
            except DeviceMemoryError:
                # Other programs use the device's memory, too: less may fit.
                if band_rows == 1:
                    raise
                band_rows //= 2
            else:
                return colours, hits

    def _render_bands(
        self, view: NDArray[np.void], band_rows: int, colours: NDArray[np.uint8], hits: NDArray[np.void]
    ) -> None:
        """Fill the colours and the hits, this many rows at a time."""
        session = self._session
        height, width = hits.shape
        buffers = [session.upload(view)]
        entry_point_buffer = ReusableBuffer(session)
        try:
            buffers.append(session.allocate(band_rows * width * _CHANNELS))
            buffers.append(session.allocate(band_rows * width * HIT.itemsize))
            view_buffer, colour_buffer, hit_buffer = buffers
            for first_row in range(0, height, band_rows):
                row_count = min(band_rows, height - first_row)
                band = {"view": view_buffer, "first_row": np.int32(first_row), "row_count": np.int32(row_count)}
                work_size, entry_points = (width, row_count), None
                if self._entry_point_kernel is not None:
                    entry_points = find_entry_points(
                        session, self._tree, self._entry_point_kernel, entry_point_buffer, work_size, self._tile, **band
                    )
                session.run(
                    self._kernel, work_size, self._tile,
                    **self._tree.arguments, **band, entry_points=entry_points, colours=colour_buffer, hits=hit_buffer,
                )  # fmt: skip
                session.download(colour_buffer, colours[first_row : first_row + row_count])
                session.download(hit_buffer, hits[first_row : first_row + row_count])
        finally:
            entry_point_buffer.release()
            for buffer in buffers:
                session.release(buffer)

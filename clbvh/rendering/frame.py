"""Pictures of one tree on the device, band by band, so that only the host's memory bounds their size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.program import build_kernels
from ..device.session import DeviceSession
from ..device.timing import EventTimes
from ..errors import DeviceMemoryError, SceneError
from ..structs import HIT, VIEW
from ..support.context_manager import ContextManager
from ..support.memory import check_memory
from ..trace.device_tree import DeviceTree
from ..trace.rays.entry_points import find_entry_points
from ..trace.running_calls import CallMemory, MemoryLoan, RunningCalls

# Pixels per kernel launch: 320 MiB of colours and hits on the device. A 4K picture is one launch.
BAND_PIXELS = 2**24

_CHANNELS = 4

# Of the host: the channels, once more without the fourth, and the hits.
_BYTES_PER_PIXEL = 2 * _CHANNELS - 1 + HIT.itemsize


class FrameRenderer(ContextManager):
    """Renders pictures of one tree, from any number of threads; their memory on the device is kept for the next one.

    Parameters
    ----------
    session : DeviceSession
        Closed with the renderer.
    tree : DeviceTree
        In the same session.
    tile : (int, int), optional
        Columns and rows of a work-group; by default those of the device's settings.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses the kernel.

    Attributes
    ----------
    calls : RunningCalls
        The pictures that are being rendered.
    """

    def __init__(self, session: DeviceSession, tree: DeviceTree, tile: tuple[int, int] | None = None) -> None:
        self.calls = RunningCalls(session, "renderer")
        self._tree = tree
        self._tile = tile or session.settings.tile
        kernels = build_kernels(session, "render", tree.defines)
        self._kernel = kernels["render"]
        # Absent in a layout without entry points.
        self._entry_point_kernel = kernels.get("view_entry_points")
        self._band_pixels = session.fit_items(HIT.itemsize, BAND_PIXELS)

    def render(
        self, view: NDArray[np.void], times: EventTimes | None = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Return the colours and the hits of one view.

        Parameters
        ----------
        view : (1,) `structs.VIEW`
        times : EventTimes, optional
            Collects the times of this picture's commands, instead of the session's.

        Returns
        -------
        colours : (height, width, 4) uint8
            Red, green, blue, and 255 where something is hit.
        hits : (height, width) `structs.HIT`

        Raises
        ------
        QueryError
            The tree is no longer on the device.
        DeviceError
            The device fails, or this process was forked from one that has used OpenCL.
        """
        width, height = int(view["width"][0]), int(view["height"][0])
        with MemoryLoan(self.calls) as loan:
            memory = loan.memory
            shared_times, memory.session.times = memory.session.times, times or memory.session.times
            try:
                check_memory(f"a picture of {width} x {height}", width * height * _BYTES_PER_PIXEL, SceneError)
                colours = np.empty((height, width, _CHANNELS), np.uint8)
                hits = np.empty((height, width), HIT)
                band_rows = min(height, max(1, self._band_pixels // width))
                while True:
                    try:
                        self._render_bands(memory, view, band_rows, colours, hits)
                    except DeviceMemoryError:
                        # Other programs and idle buffers of earlier pictures take memory of the device, too.
                        if band_rows == 1:
                            raise
                        memory.release_buffers()
                        self.calls.release_idle()
                        band_rows //= 2
                        self._band_pixels = band_rows * width
                    else:
                        return colours, hits
            finally:
                memory.session.times = shared_times

    def close(self) -> None:
        """Give the device's memory back, after the pictures of other threads have ended."""
        self.calls.close()

    def _render_bands(
        self,
        memory: CallMemory,
        view: NDArray[np.void],
        band_rows: int,
        colours: NDArray[np.uint8],
        hits: NDArray[np.void],
    ) -> None:
        """Fill the colours and the hits, this many rows at a time."""
        session = memory.session
        height, width = hits.shape
        view_buffer = memory.buffer("view", for_mapping=False).take(VIEW.itemsize)
        colour_buffer = memory.buffer("colours", for_mapping=False).take(band_rows * width * _CHANNELS)
        hit_buffer = memory.buffer("hits", for_mapping=False).take(band_rows * width * HIT.itemsize)
        entry_point_buffer = memory.buffer("entry points", for_mapping=False)
        session.write(view_buffer, view)
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

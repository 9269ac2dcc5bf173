"""Pictures of one tree or scene on the device, band by band, so that only the host's memory bounds their size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.program import build_kernels
from ..device.session import DeviceSession
from ..device.timing import EventTimes
from ..errors import DeviceMemoryError, SceneError
from ..structs import VIEW
from ..support.context_manager import ContextManager
from ..support.memory import check_memory
from ..trace.launch import TracedTree
from ..trace.rays.entry_points import find_entry_points
from ..trace.running_calls import CallMemory, MemoryLoan, RunningCalls

# Pixels per kernel launch: 320 MiB of colours and hits on the device. A 4K picture is one launch.
BAND_PIXELS = 2**24

_CHANNELS = 4

# Rays go through the centres of pixels.
_MARGIN = np.float32(0)

# Of the host: the channels, and once more without the fourth.
_COLOUR_BYTES = 2 * _CHANNELS - 1


class FrameRenderer(ContextManager):
    """Renders pictures of one tree or scene, from any number of threads.

    The memory of a picture on the device is kept for the next one.

    Parameters
    ----------
    session : DeviceSession
        Closed with the renderer.
    tree : DeviceTree or DeviceScene
        In the same session.
    tile : (int, int), optional
        Columns and rows of a work-group; by default those of the device's settings.
    arguments : mapping of str to argument, optional
        Arguments of the kernel beside those of the tree: for a scene, the buffer `instance_colours`.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses the kernel.

    Attributes
    ----------
    calls : RunningCalls
        The pictures that are being rendered.
    """

    def __init__(
        self,
        session: DeviceSession,
        tree: TracedTree,
        tile: tuple[int, int] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> None:
        self.calls = RunningCalls(session, "renderer")
        self._tree = tree
        self._arguments = {**tree.arguments, **(arguments or {})}
        self._tile = tile or session.settings.tile
        name = "scene_render" if tree.has_instances else "render"
        kernels = build_kernels(session, name, tree.defines)
        self._kernel = kernels[name]
        # Absent in a layout without entry points, and in scenes.
        self._entry_point_kernel = kernels.get("view_entry_points")
        self._band_pixels = session.fit_items(tree.hit_dtype.itemsize, BAND_PIXELS)

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
        hits : (height, width) `structs.HIT` or `structs.SCENE_HIT`

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
                pixel_bytes = _COLOUR_BYTES + self._tree.hit_dtype.itemsize
                check_memory(f"a picture of {width} x {height}", width * height * pixel_bytes, SceneError)
                colours = np.empty((height, width, _CHANNELS), np.uint8)
                hits = np.empty((height, width), self._tree.hit_dtype)
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
        hit_buffer = memory.buffer("hits", for_mapping=False).take(band_rows * width * hits.itemsize)
        entry_point_buffer = memory.buffer("entry points", for_mapping=False)
        session.write(view_buffer, view)
        for first_row in range(0, height, band_rows):
            row_count = min(band_rows, height - first_row)
            band = {"view": view_buffer, "first_row": np.int32(first_row), "row_count": np.int32(row_count)}
            work_size, arguments = (width, row_count), {**self._arguments, **band}
            if self._entry_point_kernel is not None:
                arguments["entry_points"] = find_entry_points(
                    session, self._tree, self._entry_point_kernel, entry_point_buffer, work_size, self._tile,
                    margin=_MARGIN, **band,
                )  # fmt: skip
            elif not self._tree.has_instances:
                arguments["entry_points"] = None
            session.run(self._kernel, work_size, self._tile, **arguments, colours=colour_buffer, hits=hit_buffer)
            session.download(colour_buffer, colours[first_row : first_row + row_count])
            session.download(hit_buffer, hits[first_row : first_row + row_count])

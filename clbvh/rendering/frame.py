"""Pictures of one tree or scene on the device, band by band, so that only the host's memory bounds their size."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..device.context import EventTimes
from ..device.session import DeviceSession
from ..errors import DeviceMemoryError, SceneError
from ..structs import VIEW
from ..support.context_manager import ContextManager
from ..support.memory import check_memory
from ..trace.running_calls import CallMemory, MemoryLoan, RunningCalls
from ..trace.traced_tree import TracedTree

# Pixels per band: 320 MiB of colours and hits on the device. A 4K picture is one band, unless its painter needs more
# than 512 MiB for that.
BAND_PIXELS = 2**24
_PAINTER_BYTES = 2**29

# Columns and rows that painters may have beside those of a band.
_BORDER = 2

_CHANNELS = 4

# Of the host: the channels, and once more without the fourth.
_COLOUR_BYTES = 2 * _CHANNELS - 1


class Band(NamedTuple):
    """Rows of a picture that are on the device together.

    Attributes
    ----------
    memory : CallMemory
        Of the picture.
    width, height : int
        Of the whole picture, in pixels.
    first_row, row_count : int
    view, colours, hits : buffer
        The arguments of those names, see cl/kernels/render.cl.
    """

    memory: CallMemory
    width: int
    height: int
    first_row: int
    row_count: int
    view: Any
    colours: Any
    hits: Any

    @property
    def session(self) -> DeviceSession:
        """The queue of the picture."""
        return self.memory.session

    @property
    def rows(self) -> dict[str, Any]:
        """The arguments of every kernel that works on a band."""
        return {"view": self.view, "first_row": np.int32(self.first_row), "row_count": np.int32(self.row_count)}


class Painter(Protocol):
    """Fills the colours and the hits of a band."""

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the largest buffer for each pixel, beside those of the band."""

    def paint(self, band: Band) -> None:
        """Run the kernels; the buffers of the band are complete afterwards."""


class FrameRenderer(ContextManager):
    """Renders pictures of one tree or scene, from any number of threads.

    The memory of a picture on the device is kept for the next one.

    Parameters
    ----------
    session : DeviceSession
        Closed with the renderer.
    tree : DeviceTree or DeviceScene
        In the same session.

    Attributes
    ----------
    calls : RunningCalls
        The pictures that are being rendered.
    """

    def __init__(self, session: DeviceSession, tree: TracedTree) -> None:
        self.calls = RunningCalls(session, "renderer")
        self._hit_dtype = tree.hit_dtype
        self._band_pixels = session.fit_items(tree.hit_dtype.itemsize, BAND_PIXELS)

    def render(
        self, view: NDArray[np.void], painter: Painter, times: EventTimes | None = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Return the colours and the hits of one view.

        Parameters
        ----------
        view : (1,) `structs.VIEW`
        painter : Painter
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
                pixel_bytes = _COLOUR_BYTES + self._hit_dtype.itemsize
                check_memory(f"a picture of {width} x {height}", width * height * pixel_bytes, SceneError)
                colours = np.empty((height, width, _CHANNELS), np.uint8)
                hits = np.empty((height, width), self._hit_dtype)
                row_bytes = max(1, painter.pixel_bytes) * (width + _BORDER)
                fitting = memory.session.fit_items(row_bytes, _PAINTER_BYTES // row_bytes) - _BORDER
                band_rows = min(height, max(1, min(self._band_pixels // width, fitting)))
                while True:
                    try:
                        self._render_bands(memory, view, painter, band_rows, colours, hits)
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
        painter: Painter,
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
        session.write(view_buffer, view)
        for first_row in range(0, height, band_rows):
            row_count = min(band_rows, height - first_row)
            painter.paint(Band(memory, width, height, first_row, row_count, view_buffer, colour_buffer, hit_buffer))
            session.download(colour_buffer, colours[first_row : first_row + row_count])
            session.download(hit_buffer, hits[first_row : first_row + row_count])

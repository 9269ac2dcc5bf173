"""The pixels of a picture on the device, band by band, so that only the host's memory bounds their number.

A painter fills a band, see `painters.py`. The device keeps the memory of a picture for the next one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..device.times import CommandTimes
from ..errors import SceneError
from ..structs import VIEW
from ..support.memory import check_memory
from ..trace.launch import Call, Caster
from ..trace.running_calls import CallMemory
from .progress import LAUNCH_S, Progress

# Pixels per band: 320 MiB of colours and hits on the device. A 4K picture is one band, unless its painter needs more
# than 512 MiB for that.
BAND_PIXELS = 2**24
_PAINTER_BYTES = 2**29

# Rows of the first band where launches are to be short, and the most by which the next band is larger.
_FIRST_ROWS, _MOST_GROWTH = 32, 4

# Columns and rows that painters may have beside those of a band.
BORDER = 2

_CHANNELS = 4

# Four channels of float32.
FILM_BYTES = 16

# Of the host: the channels, and once more without the fourth.
_COLOUR_BYTES = 2 * _CHANNELS - 1

# The kernel that makes colours of a film; it knows no tree.
DEVELOP = "develop"


class Band(NamedTuple):
    """Rows of a picture that are on the device together.

    Attributes
    ----------
    memory : CallMemory
        Of the picture.
    width, height : int
        Of the whole picture, in pixels.
    first_row, row_count : int
    report : function
        Called with the share of the band's samples that are done; it raises where the picture is to end early.
    view, colours, hits : buffer
        The arguments of those names, see cl/kernels/render.cl.
    """

    memory: CallMemory
    width: int
    height: int
    first_row: int
    row_count: int
    report: Callable[[float], None]
    view: Any
    colours: Any
    hits: Any

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the band."""
        return self.width, self.row_count

    @property
    def rows(self) -> dict[str, Any]:
        """The arguments of every kernel that works on a band."""
        return {"view": self.view, "first_row": np.int32(self.first_row), "row_count": np.int32(self.row_count)}

    def run(self, kernel: Any, size: tuple[int, int], tile: tuple[int, int], **arguments: Any) -> None:
        """Run a kernel in the queue of the picture."""
        self.memory.session.run(kernel, size, tile, **arguments)

    def take(self, name: str, size: int) -> Any:
        """Return a buffer of at least `size` bytes."""
        return self.memory.buffer(name, for_mapping=False).take(size)


class Painter(Protocol):
    """What fills bands."""

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the largest buffer for each pixel, beside those of the band."""

    def paint(self, band: Band) -> float:
        """Fill the colours and the hits of a band; return the seconds of the first launch."""


def render_frame(
    caster: Caster,
    kernel_view: NDArray[np.void],
    painter: Painter,
    progress: Progress,
    times: CommandTimes | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
    """Return the colours and the hits of one view.

    Parameters
    ----------
    caster : Caster
        A picture is a call of it.
    kernel_view : (1,) `structs.VIEW`
    painter : Painter
    progress : Progress
        Where its launches are to be shorter than usual, bands are chosen so that one takes about this time.
    times : CommandTimes, optional
        Collects the times of this picture's commands, instead of the session's.

    Returns
    -------
    colours : (height, width, 4) uint8
        Red, green, blue, and 255 where something is hit.
    hits : (height, width) `structs.HIT` or `structs.WORLD_HIT`

    Raises
    ------
    QueryError
        The tree is no longer on the device.
    DeviceError
        The device fails, or this process was forked from one that has used OpenCL.
    """
    width, height = int(kernel_view["width"][0]), int(kernel_view["height"][0])
    hit_dtype = caster.world.hit_dtype
    check_memory(f"a picture of {width} x {height}", width * height * (_COLOUR_BYTES + hit_dtype.itemsize), SceneError)
    colours, hits = np.empty((height, width, _CHANNELS), np.uint8), np.empty((height, width), hit_dtype)

    def paint(call: Call) -> None:
        session = call.session
        row_bytes = max(1, painter.pixel_bytes) * (width + BORDER)
        fitting = session.fit_items(row_bytes, _PAINTER_BYTES // row_bytes) - BORDER
        fitting = min(height, session.fit_items(hit_dtype.itemsize, BAND_PIXELS) // width, fitting)
        shared_times, session.times = session.times, times or session.times
        try:
            # Other programs take memory of the device, too: then bands are halved.
            most = max(1, fitting >> caster.calls.halvings)
            _render_bands(call, kernel_view, painter, progress, most, colours, hits)
        finally:
            session.times = shared_times

    caster.run(paint)
    return colours, hits


def _render_bands(
    call: Call, kernel_view: NDArray[np.void], painter: Painter, progress: Progress, band_rows: int,
    colours: NDArray[Any], hits: NDArray[Any],
) -> None:  # fmt: skip
    """Fill the colours and the hits, at most this many rows at a time."""
    session, memory, (height, width), launch_s = call.session, call.memory, hits.shape, progress.launch_s
    sizes = {"view": VIEW.itemsize, "colours": band_rows * width * _CHANNELS, "hits": band_rows * width * hits.itemsize}
    buffers = {name: memory.buffer(name, for_mapping=False).take(size) for name, size in sizes.items()}
    session.write(buffers["view"], kernel_view)
    first_row, row_count = 0, band_rows if launch_s >= LAUNCH_S else min(_FIRST_ROWS, band_rows)
    while first_row < height:
        end = min(first_row + row_count, height)

        def report(share: float, first_row: int = first_row, end: int = end) -> None:
            progress.show(first_row + (end - first_row) * share, height, width)

        spent_s = painter.paint(Band(memory, width, height, first_row, end - first_row, report, **buffers))
        session.download(buffers["colours"], colours[first_row:end])
        session.download(buffers["hits"], hits[first_row:end])
        first_row = end
        if launch_s < LAUNCH_S:
            tile_rows = session.settings.tile[1]
            fitting = int(min(launch_s / max(spent_s, 1e-9), _MOST_GROWTH) * row_count) // tile_rows * tile_rows
            row_count = min(max(tile_rows, fitting), band_rows)


def develop_film(caster: Caster, kernel_view: NDArray[np.void], film: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the colours of a film, (height, width, 4) uint8; see cl/kernels/develop.cl.

    Parameters
    ----------
    caster : Caster
    kernel_view : (1,) `structs.VIEW`
    film : (height, width, 4) float32
        Means of samples.
    """
    height, width = film.shape[:2]
    colours = np.empty((height, width, _CHANNELS), np.uint8)
    with caster.open_call() as call:
        session = call.session
        kernel = session.kernel(DEVELOP)
        band_rows = min(height, max(1, session.fit_items(FILM_BYTES, BAND_PIXELS) // width))
        sizes = {
            "view": VIEW.itemsize,
            "film": band_rows * width * FILM_BYTES,
            "colours": band_rows * width * _CHANNELS,
        }
        buffers = {name: call.memory.buffer(name, for_mapping=False).take(size) for name, size in sizes.items()}
        session.write(buffers["view"], kernel_view)
        for first_row in range(0, height, band_rows):
            rows = film[first_row : first_row + band_rows]
            session.write(buffers["film"], rows)
            counts = {"row_count": np.int32(len(rows)), "sample_count": np.int32(1), "counts": None}
            session.run(kernel, (width, len(rows)), session.settings.tile, **buffers, **counts)
            session.download(buffers["colours"], colours[first_row : first_row + band_rows])
    return colours

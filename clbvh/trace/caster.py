"""Runs a traversal kernel over rays or points, chunk by chunk; what a chunk's results become is the caller's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..closing import Closing
from ..device.kept_buffer import KeptBuffer
from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..device.settings import find_settings
from ..host_threads import HostThreads
from ..layout import RAY
from .device_tree import DeviceTree
from .entries import TileEntries, open_tile_entries
from .picture_rows import find_row_length
from .ray_order import are_many, find_order
from .rays import RayBatch, RayBox, pack_rays

# Rays or points on the device at a time, whatever the size of the batch: 48 MiB of rays and hits, and 4 MiB more where
# rays are sorted, or 7 MiB where they begin together. They are sorted among so many.
CHUNK_RAYS = 2**20

Progress = Callable[[int, int], None]
Packer = Callable[[int, int, NDArray[np.void]], None]


class _Given(NamedTuple):
    """What is on the device, and how kernels take it."""

    rows: Any  # a buffer of rays or points
    size: tuple[int, int]  # columns and rows of work-items
    tile: tuple[int, int]  # of a work-group
    more: tuple[Any, ...]  # of rays: how many are in a row, their order and their tiles' entries


_NOTHING = _Given(None, (0, 0), (1, 1), ())


class Caster(Closing):
    """One tree on one device, and the buffers through which rays and results pass.

    Parameters
    ----------
    session : DeviceSession
        Closed with the caster.
    tree : DeviceTree
    box : RayBox
        Around the tree.
    """

    def __init__(self, session: DeviceSession, tree: DeviceTree, box: RayBox) -> None:
        self.session = session
        self.tree = tree
        self.threads = HostThreads()
        self.box = box
        settings = find_settings(session.info)
        self._tile, self._row_tile = settings.tile, (settings.group_size, 1)
        self._kernels: dict[str, Any] = {}
        self._buffers: dict[str, KeptBuffer] = {}
        self._entries: TileEntries | None = None
        self._given = _NOTHING

    @property
    def most_rows(self) -> int:
        """Rays or points of a chunk."""
        return CHUNK_RAYS

    def ray_chunks(self, batch: RayBatch, progress: Progress | None = None) -> Iterator[tuple[int, int]]:
        """Put rays on the device, chunk by chunk, and yield where each one begins and ends; see `cut`.

        Results come in the order of the rays, in whatever order the device takes them.
        """
        row_length, chunk_rays = self._find_rows(batch, CHUNK_RAYS)
        for begin, end in self.cut(len(batch), progress, chunk_rays):
            order = find_order(batch, begin, end, self.box, self.threads, is_picture=row_length is not None)
            if order.numbers is None:
                self.upload_rays(batch, begin, end, row_length, is_coherent=order.is_coherent)
            else:
                numbers = self._buffer("order", len(order.numbers), order.numbers.dtype)
                with self.session.mapped(numbers, len(order.numbers), order.numbers.dtype, write=True) as rows:
                    rows[:] = order.numbers
                self._upload_some(batch.part(begin, end), begin, order.numbers, numbers)
            yield begin, end

    def ray_pieces(
        self, batch: RayBatch, most_rays: int, progress: Progress | None = None
    ) -> Iterator[tuple[int, NDArray[np.int32]]]:
        """Put rays on the device, at most so many at a time, and yield their numbers in the order of the results.

        Yields
        ------
        begin : int
        numbers : (n,) int32
            Counted from `begin`.
        """
        row_length, piece_rays = self._find_rows(batch, min(most_rays, CHUNK_RAYS))
        for begin, end in self.cut(len(batch), None, CHUNK_RAYS // piece_rays * piece_rays):
            order = find_order(batch, begin, end, self.box, self.threads, is_picture=row_length is not None)
            chunk = None if order.numbers is None else batch.part(begin, end)
            for first in range(begin, end, piece_rays):
                last = min(first + piece_rays, end)
                if order.numbers is None or chunk is None:
                    self.upload_rays(batch, first, last, row_length, is_coherent=order.is_coherent)
                    numbers = np.arange(first - begin, last - begin, dtype=np.int32)
                else:
                    numbers = order.numbers[first - begin : last - begin]
                    self._upload_some(chunk, begin, numbers)
                yield begin, numbers
                if progress is not None:
                    progress(last, len(batch))

    def cut(
        self, row_count: int, progress: Progress | None, chunk_rows: int | None = None
    ) -> Iterator[tuple[int, int]]:
        """Yield where each chunk of rays or points begins and ends.

        Parameters
        ----------
        row_count : int
        progress : function, optional
            Called with the number of rows that are done, and of all rows, after each chunk.
        chunk_rows : int, optional
            `most_rows` without it.

        Raises
        ------
        ValueError
            The tree is no longer on the device.
        """
        if self.session.is_closed:
            raise ValueError("the tracer is closed: its tree is no longer on the device")
        step = chunk_rows or self.most_rows
        for begin in range(0, row_count, step):
            end = min(begin + step, row_count)
            yield begin, end
            if progress is not None:
                progress(end, row_count)

    def upload_rows(self, dtype: np.dtype, count: int, pack: Packer) -> None:
        """Put rows on the device, in the place of those that are there.

        Parameters
        ----------
        dtype : numpy.dtype
            Of a row on the device.
        count : int
        pack : function
            Called with where a range of rows begins and ends, and the array to write them to; from several threads.
        """
        self._given = _Given(self._upload(dtype, count, pack), (count, 1), self._row_tile, ())

    def upload_rays(
        self, batch: RayBatch, begin: int, end: int, row_length: int | None = None, *, is_coherent: bool = False
    ) -> None:
        """Put some of the rays on the device, in the place of those that are there.

        Parameters
        ----------
        batch : RayBatch
        begin, end : int
        row_length : int, optional
            Where they are the rows of a picture, the first one from its beginning.
        is_coherent : bool
            Whether rays beside each other begin together.
        """

        def pack(first: int, last: int, rows: NDArray[np.void]) -> None:
            pack_rays(batch.part(begin + first, begin + last), self.box, rows, first_row=begin + first)

        buffer = self._upload(RAY, end - begin, pack)
        width = row_length or end - begin
        size, tile = (width, -(-(end - begin) // width)), self._tile if row_length else self._row_tile
        entries = self._find_entries(size, tile, buffer, end - begin) if is_coherent else None
        self._given = _Given(buffer, size, tile, (np.int32(width), None, entries))

    def _upload_some(self, chunk: RayBatch, begin: int, numbers: NDArray[np.int32], order: Any | None = None) -> None:
        """Put some rays of a chunk on the device, in another order; the first ray of the chunk is number `begin`.

        `order` is a buffer with their numbers, if results are to be in the order of the chunk.
        """

        def pack(first: int, last: int, rows: NDArray[np.void]) -> None:
            pack_rays(chunk, self.box, rows, first_row=begin, order=numbers[first:last])

        buffer = self._upload(RAY, len(numbers), pack)
        self._given = _Given(buffer, (len(numbers), 1), self._row_tile, (np.int32(len(numbers)), order, None))

    def _find_rows(self, batch: RayBatch, most_rays: int) -> tuple[int | None, int]:
        """Return how long a picture's rows are, or None, and how many rays to take at a time: whole rows of tiles."""
        row_length = find_row_length(batch) if self.tree.entry_bytes and are_many(len(batch)) else None
        band = (row_length or most_rays + 1) * self._tile[1]
        return (None, most_rays) if band > most_rays else (row_length, most_rays // band * band)

    def _find_entries(self, size: tuple[int, int], tile: tuple[int, int], rays: Any, ray_count: int) -> Any | None:
        """Return where the rays on the device enter the tree."""
        if self._entries is None:
            self._entries = open_tile_entries(self.session, self.tree)
        return self._entries.find(size, tile, rays, np.int32(ray_count), np.int32(size[0]))

    def _upload(self, dtype: np.dtype, count: int, pack: Packer) -> Any:
        """Put rows on the device, in the place of those that are there, and return the buffer."""
        given = self._buffer("given", count, dtype)
        with self.session.mapped(given, count, dtype, write=True) as rows:
            self.threads.for_ranges(count, lambda first, last: pack(first, last, rows[first:last]))
        return given

    @contextmanager
    def cast(
        self, query: str, row_count: int, dtype: np.dtype, *arguments: Any, result_count: int | None = None
    ) -> Iterator[NDArray[Any]]:
        """Run a kernel over the rows on the device and give its results, for as long as the block lasts.

        Parameters
        ----------
        query : str
            The kernel's name.
        row_count : int
            At least 1.
        dtype : numpy.dtype
            Of a result.
        *arguments
            What the kernel takes behind the rows, and how they are taken.
        result_count : int, optional
            Where there is not one result for each row.
        """
        count = row_count if result_count is None else result_count
        results = self._buffer("results", count, dtype)
        self.session.run(
            self._kernel(query), self._given.size, self._given.tile,
            *self.tree.arguments, self._given.rows, results, np.int32(row_count), *self._given.more, *arguments,
        )  # fmt: skip
        with self.session.mapped(results, count, dtype, write=False) as found:
            yield found

    def close(self) -> None:
        """Give the device's memory back."""
        self.release()
        self.session.close()

    def release(self) -> None:
        """Give back what rays and results pass through; the tree stays."""
        self.threads.close()
        for buffer in self._buffers.values():
            buffer.release()
        if self._entries is not None:
            self._entries.release()
        self._given = _NOTHING

    def _kernel(self, query: str) -> Any:
        if query not in self._kernels:
            self._kernels[query] = build_kernel(self.session, query, self.tree.defines)
        return self._kernels[query]

    def _buffer(self, name: str, row_count: int, dtype: np.dtype) -> Any:
        """Return a buffer that is kept between calls."""
        if name not in self._buffers:
            self._buffers[name] = KeptBuffer(self.session, for_mapping=True)
        return self._buffers[name].take(row_count * dtype.itemsize)

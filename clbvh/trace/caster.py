"""Runs a traversal kernel over rays or points, chunk by chunk; what a chunk's results become is the caller's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..closing import Closing
from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..device.settings import find_settings
from ..host_threads import HostThreads
from ..layout import RAY
from .device_tree import DeviceTree
from .ray_order import find_order
from .rays import RayBatch, RayBox, pack_rays

# Rays or points on the device at a time, whatever the size of the batch: 48 MiB of rays and hits, and 4 MiB more where
# rays are sorted. They are sorted among so many.
CHUNK_RAYS = 2**20

Progress = Callable[[int, int], None]
Packer = Callable[[int, int, NDArray[np.void]], None]


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
        self._group_size = find_settings(session.info).group_size
        self._kernels: dict[str, Any] = {}
        self._buffers: dict[str, tuple[Any, int]] = {}
        self._given: tuple[Any, ...] = ()  # what kernels take: rays and their order, or points

    @property
    def most_rows(self) -> int:
        """Rays or points of a chunk."""
        return CHUNK_RAYS

    def ray_chunks(self, batch: RayBatch, progress: Progress | None = None) -> Iterator[tuple[int, int]]:
        """Put rays on the device, chunk by chunk, and yield where each one begins and ends; see `chunks`.

        Results come in the order of the rays, in whatever order the device takes them.
        """
        for begin, end in self._cut(len(batch), progress):
            order = find_order(batch, begin, end, self.box, self.threads)
            if order is None:
                self.upload_rays(batch, begin, end)
            else:
                self._upload_some(batch.part(begin, end), begin, order)
                numbers = self._buffer("order", len(order), order.dtype)
                with self.session.mapped(numbers, len(order), order.dtype, write=True) as rows:
                    rows[:] = order
                self._given = self._given[0], numbers
            yield begin, end

    def ray_pieces(
        self, batch: RayBatch, most_rows: int, progress: Progress | None = None
    ) -> Iterator[tuple[int, NDArray[np.int32]]]:
        """Put rays on the device, at most so many at a time, and yield their numbers in the order of the results.

        Yields
        ------
        begin : int
        numbers : (n,) int32
            Counted from `begin`.
        """
        for begin, end in self._cut(len(batch), None):
            order = find_order(batch, begin, end, self.box, self.threads)
            chunk = None if order is None else batch.part(begin, end)
            for first in range(begin, end, most_rows):
                last = min(first + most_rows, end)
                if order is None or chunk is None:
                    self.upload_rays(batch, first, last)
                    numbers = np.arange(first - begin, last - begin, dtype=np.int32)
                else:
                    numbers = order[first - begin : last - begin]
                    self._upload_some(chunk, begin, numbers)
                yield begin, numbers
                if progress is not None:
                    progress(last, len(batch))

    def chunks(
        self,
        row_count: int,
        dtype: np.dtype,
        pack: Packer,
        progress: Progress | None = None,
    ) -> Iterator[tuple[int, int]]:
        """Put a batch on the device, chunk by chunk, and yield where each one begins and ends.

        Parameters
        ----------
        row_count : int
        dtype : numpy.dtype
            Of a row on the device.
        pack : function
            Called with where a range of rows begins and ends, and the array to write them to; from several threads.
        progress : function, optional
            Called with the number of rows that are done, and of all rows, after each chunk.

        Raises
        ------
        ValueError
            A row is bad, or the tree is no longer on the device.
        """
        for begin, end in self._cut(row_count, progress):

            def pack_chunk(first: int, last: int, rows: NDArray[np.void], begin: int = begin) -> None:
                pack(begin + first, begin + last, rows)

            self._upload(dtype, end - begin, pack_chunk)
            yield begin, end

    def upload_rays(self, batch: RayBatch, begin: int, end: int) -> None:
        """Put some of the rays on the device, in the place of those that are there."""

        def pack(first: int, last: int, rows: NDArray[np.void]) -> None:
            pack_rays(batch.part(begin + first, begin + last), self.box, rows, first_row=begin + first)

        self._upload(RAY, end - begin, pack)

    def _upload_some(self, chunk: RayBatch, begin: int, numbers: NDArray[np.int32]) -> None:
        """Put some rays of a chunk on the device, in another order; the first ray of the chunk is number `begin`."""

        def pack(first: int, last: int, rows: NDArray[np.void]) -> None:
            pack_rays(chunk, self.box, rows, first_row=begin, order=numbers[first:last])

        self._upload(RAY, len(numbers), pack)

    def _cut(self, row_count: int, progress: Progress | None) -> Iterator[tuple[int, int]]:
        """Yield where each chunk begins and ends, and tell when it is done."""
        if self.session.is_closed:
            raise ValueError("the tracer is closed: its tree is no longer on the device")
        for begin in range(0, row_count, CHUNK_RAYS):
            end = min(begin + CHUNK_RAYS, row_count)
            yield begin, end
            if progress is not None:
                progress(end, row_count)

    def _upload(self, dtype: np.dtype, count: int, pack: Packer) -> None:
        """Put rows on the device, in the place of those that are there."""
        given = self._buffer("given", count, dtype)
        self._given = given, *((None,) if dtype == RAY else ())
        with self.session.mapped(given, count, dtype, write=True) as rows:
            self.threads.for_ranges(count, lambda first, last: pack(first, last, rows[first:last]))

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
            What the kernel takes behind the number of rows, and the order of rays.
        result_count : int, optional
            Where there is not one result for each row.
        """
        count = row_count if result_count is None else result_count
        results = self._buffer("results", count, dtype)
        self.session.run(
            self._kernel(query), (row_count,), (self._group_size,),
            *self.tree.arguments, self._given[0], results, np.int32(row_count), *self._given[1:], *arguments,
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
        for buffer, _ in self._buffers.values():
            self.session.release(buffer)
        self._buffers.clear()
        self._given = ()

    def _kernel(self, query: str) -> Any:
        if query not in self._kernels:
            self._kernels[query] = build_kernel(self.session, query, self.tree.defines)
        return self._kernels[query]

    def _buffer(self, name: str, row_count: int, dtype: np.dtype) -> Any:
        """Return a buffer that is kept between calls; a larger one replaces it when needed."""
        size = row_count * dtype.itemsize
        kept, kept_size = self._buffers.get(name, (None, 0))
        if kept_size < size:
            if kept is not None:
                del self._buffers[name]
                self.session.release(kept)
            kept = self.session.allocate(size, for_mapping=True)
            self._buffers[name] = kept, size
        return kept

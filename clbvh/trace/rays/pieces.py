"""A batch of rays is cut into pieces, each of which is cast in one launch, in an order that suits the device.

Four facts are looked up here, and nowhere else: whether the rays are a picture (then they are cast tile by tile),
whether they are scattered, whether their traversal is long enough that sorting pays (then they are sorted), and whether
they are coherent, in their own order or sorted (then the rays of a tile begin at an entry point of their own).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..world.tree_box import TreeBox
from .batch import RayBatch
from .coherence import KeyOrder, find_row_length, is_pencil, is_picture_size, is_scattered, sort_rays, spread_samples

# Rays or points on the device at a time, whatever the size of the batch: 48 MiB of rays and hits, and 4 MiB more where
# rays are sorted, and 7 MiB where they have entry points; on the host, which casts rays where they are, 16 MiB of hits
# where they are sorted. Rays are sorted among this many.
CHUNK_RAYS = 2**20

# Smaller batches earn back neither the sort nor the search for entry points: that search takes as long as it saves at
# 16,384 rays of a picture, and 65,536 are 1.1 times as fast with it. The sort, whole calls, sorted against unsorted,
# closest, any and all hits, medians on 2 cores of an x86-64 server, dragon:
#            shuffled picture    from around         from anywhere       in any order from the surface
# 32,768     0.99 0.87 0.72      0.81 0.89 1.01      1.11 1.02 0.99      1.09 1.43 1.10
# 65,536     0.84 0.75 0.63      0.99 0.94 0.93      1.08 1.07 0.94      1.00 0.96 0.89
# 131,072    0.79 0.65 0.55      0.89 0.98 0.84      1.08 0.97 0.86      0.93 0.83 0.81
LEAST_RAYS = 1 << 16

# Scattered rays that visit fewer nodes and leaves, on average, are cast faster than sorted, in a tree of up to
# MOST_SAMPLED_BYTES: docs/internals/decisions.md has the measurements. Sorted, a pencil gets entry points as well.
_LEAST_STEPS = 3.3
_LEAST_PENCIL_STEPS = 2.0

# Larger trees are waited for by rays in no order, however few nodes they visit: on the dragon, whose tree takes 56 MB,
# sorting pays from 1.8 visits on. The tree of 100,000 triangles, for which the limits above hold, takes 7 MB.
MOST_SAMPLED_BYTES = 1 << 24

# Rays whose visits are counted: 0.1 ms, and their mean is true to a tenth of a visit.
_SAMPLES = 512

Progress = Callable[[int, int], None]
StepCounter = Callable[[RayBatch], float]


class Piece(NamedTuple):
    """Rays that are cast in one launch, or points that are looked up.

    Attributes
    ----------
    begin, end : int
        The chunk: a range of the batch's rays.
    order : (n,) int32 or None
        Rays of the piece, one after the other, counted from `begin`; None: all of the chunk, in their own order.
    row_length : int or None
        Rays in a row of a picture, if they are one; the piece begins at the beginning of a row.
    is_coherent : bool
        Whether neighbours are known to take similar ways, so that the rays of a tile may share an entry point.
    """

    begin: int
    end: int
    order: NDArray[np.int32] | None = None
    row_length: int | None = None
    is_coherent: bool = False

    @property
    def item_count(self) -> int:
        """Number of rays in the piece."""
        return self.end - self.begin if self.order is None else len(self.order)

    def item_ids(self) -> NDArray[np.int32]:
        """Return (n,) int32: the piece's rays, counted from `begin`."""
        return np.arange(self.end - self.begin, dtype=np.int32) if self.order is None else self.order

    def only(self, order: NDArray[np.int32]) -> Piece:
        """Return the piece with some of its rays alone, counted from `begin`."""
        return Piece(self.begin, self.end, order)

    def split(self, most_items: int) -> Iterator[Piece]:
        """Yield parts with `most_items` rays at most."""
        if self.item_count <= most_items:
            yield self
            return
        order = self.item_ids()
        for first in range(0, len(order), most_items):
            yield self.only(order[first : first + most_items])


def cut_rays(
    batch: RayBatch,
    box: TreeBox,
    order_by_keys: KeyOrder,
    *,
    tile_rows: int,
    finds_pictures: bool = True,
    chunk_limit: int = 0,
    most_rays: int = 0,
    count_steps: StepCounter | None = None,
    progress: Progress | None = None,
) -> Iterator[Piece]:
    """Yield the pieces of a batch, one after the other.

    Parameters
    ----------
    batch : RayBatch
    box : TreeBox
    order_by_keys : function
    tile_rows : int
        Rows of a work-group of a picture: pieces of a picture are whole rows of tiles.
    finds_pictures : bool
        Whether pictures are looked for at all: they gain only where there are entry points.
    chunk_limit : int
        Rays of a chunk, at most; `CHUNK_RAYS` without it.
    most_rays : int
        Rays of a piece, at most. Without it every piece is a whole chunk.
    count_steps : function, optional
        Called with a sample of the rays, it returns the nodes and leaves that one of them visits on average. Without
        it, scattered rays are always sorted.
    progress : function, optional
        Called with the number of rays that are done, and of all rays, after each piece.
    """
    ray_count = batch.ray_count
    chunk_limit = min(chunk_limit or CHUNK_RAYS, CHUNK_RAYS)
    most_rays = min(most_rays or chunk_limit, chunk_limit)
    row_length = None
    if finds_pictures and ray_count >= LEAST_RAYS:
        # Of arrays with two or more leading dimensions, the last one is a row.
        row_length = _row_length_of_shape(batch.shape) or find_row_length(batch)
    band_rays = (row_length or most_rays + 1) * tile_rows
    if band_rays > most_rays:
        row_length, piece_rays = None, most_rays
    else:
        piece_rays = most_rays // band_rays * band_rays
    chunk_rays = chunk_limit // piece_rays * piece_rays

    for begin in range(0, ray_count, chunk_rays):
        end = min(begin + chunk_rays, ray_count)
        is_many = end - begin >= max(LEAST_RAYS, 2)
        # The rows that were found in the rays themselves are coherent; those of a shape are the user's word.
        is_found = row_length is not None and not _row_length_of_shape(batch.shape)
        order, is_coherent = None, is_many
        if is_many and not is_found and is_scattered(batch, begin, end, box):
            # Sorted, the rays of a pencil are as good as those of a picture.
            is_coherent = is_pencil(batch, begin, end, box)
            least_steps = _LEAST_PENCIL_STEPS if is_coherent else _LEAST_STEPS
            if count_steps is None or count_steps(batch.take(spread_samples(begin, end, _SAMPLES))) >= least_steps:
                order = sort_rays(batch, begin, end, box, order_by_keys, is_pencil=is_coherent)
            else:
                is_coherent = False
        for first in range(begin, end, piece_rays):
            last = min(first + piece_rays, end)
            if order is not None:
                yield Piece(begin, end, order[first - begin : last - begin], None, is_coherent)
            else:
                yield Piece(first, last, None, row_length, is_coherent)
            if progress is not None:
                progress(last, ray_count)


def cut_points(count: int, *, most_points: int = 0, progress: Progress | None = None) -> Iterator[tuple[int, int]]:
    """Yield begin and end of the chunks in which points are cast.

    Parameters
    ----------
    count : int
        Points to cast.
    most_points : int
        Points of a chunk, at most; `CHUNK_RAYS` without it.
    progress : function, optional
        Called with the number of points that are done, and of all points, after each chunk.
    """
    chunk_points = min(most_points or CHUNK_RAYS, CHUNK_RAYS)
    for begin in range(0, count, chunk_points):
        end = min(begin + chunk_points, count)
        yield begin, end
        if progress is not None:
            progress(end, count)


def _row_length_of_shape(shape: tuple[int, ...]) -> int | None:
    """Return the row length of arrays that have the shape of a picture, or of several."""
    if len(shape) < 2:
        return None
    row_length = shape[-1]
    row_count = int(np.prod(shape[:-1]))
    return row_length if is_picture_size(row_length, row_count) else None

"""A batch of rays is cut into pieces, each of which is cast in one launch, in an order that suits the device.

Four facts are looked up here, and nowhere else: whether the rays are a picture (then they are cast tile by tile),
whether they are scattered, whether their traversal is long enough that sorting pays (then they are sorted), and whether
they are coherent, in their own order or sorted (then the rays of a tile begin at an entry point of their own).

A piece is packed into buffers of the call that casts it. A world with instances gets what float32 rounds off each ray
as well, once for all rays where that is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import PACKED_RAY, RAY_LOW
from ...support.host_threads import HostThreads
from ..host.walk import count_steps
from ..launch import Batch, Call
from ..world.starts import AT_THE_ROOT, TILE_KERNEL, find_entry_points
from ..world.world import World
from .batch import RayBatch, RayRows, TreeBox
from .coherence import find_row_length, is_pencil, is_picture_size, is_scattered, sort_rays, spread_samples
from .pack import find_shared_low, pack_rays

# Rays or points on the device at a time, whatever the size of the batch: 48 MiB of rays and hits, and 4 MiB more where
# rays are sorted, and 7 MiB where they have entry points. Rays are sorted among this many.
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


class RayPiece(NamedTuple):
    """Rays that are cast in one launch.

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
    def ray_count(self) -> int:
        """Number of rays in the piece."""
        return self.end - self.begin if self.order is None else len(self.order)

    def ray_ids(self) -> NDArray[np.int32]:
        """Return (n,) int32: the piece's rays, counted from `begin`."""
        return np.arange(self.end - self.begin, dtype=np.int32) if self.order is None else self.order


def cut_rays(
    batch: RayBatch,
    box: TreeBox,
    threads: HostThreads,
    *,
    tile_rows: int,
    shape: tuple[int, ...] = (),
    finds_pictures: bool = True,
    chunk_limit: int = 0,
    most_rays: int = 0,
    count_steps: StepCounter | None = None,
    progress: Progress | None = None,
) -> Iterator[RayPiece]:
    """Yield the pieces of a batch, one after the other.

    Parameters
    ----------
    batch : RayBatch
    box : TreeBox
    threads : HostThreads
    tile_rows : int
        Rows of a work-group of a picture: pieces of a picture are whole rows of tiles.
    shape : tuple of int
        Leading shape of the user's arrays. Two or more dimensions are a picture, the last one its row.
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
        row_length = _row_length_of_shape(shape) or find_row_length(batch)
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
        is_found = row_length is not None and not _row_length_of_shape(shape)
        order, is_coherent = None, is_many
        if is_many and not is_found and is_scattered(batch, begin, end, box):
            # Sorted, the rays of a pencil are as good as those of a picture.
            is_coherent = is_pencil(batch, begin, end, box)
            least_steps = _LEAST_PENCIL_STEPS if is_coherent else _LEAST_STEPS
            if count_steps is None or count_steps(batch.take(spread_samples(begin, end, _SAMPLES))) >= least_steps:
                order = sort_rays(batch, begin, end, box, threads, is_pencil=is_coherent)
            else:
                is_coherent = False
        for first in range(begin, end, piece_rays):
            last = min(first + piece_rays, end)
            if order is not None:
                yield RayPiece(begin, end, order[first - begin : last - begin], None, is_coherent)
            else:
                yield RayPiece(first, last, None, row_length, is_coherent)
            if progress is not None:
                progress(last, ray_count)


def cut_points(
    point_count: int, *, most_points: int = 0, progress: Progress | None = None
) -> Iterator[tuple[int, int]]:
    """Yield begin and end of the chunks in which points are cast.

    Parameters
    ----------
    point_count : int
    most_points : int
        Points of a chunk, at most; `CHUNK_RAYS` without it.
    progress : function, optional
        Called with the number of points that are done, and of all points, after each chunk.
    """
    chunk_points = min(most_points or CHUNK_RAYS, CHUNK_RAYS)
    for begin in range(0, point_count, chunk_points):
        end = min(begin + chunk_points, point_count)
        yield begin, end
        if progress is not None:
            progress(end, point_count)


def _row_length_of_shape(shape: tuple[int, ...]) -> int | None:
    """Return the row length of arrays that have the shape of a picture, or of several."""
    if len(shape) < 2:
        return None
    row_length = shape[-1]
    row_count = int(np.prod(shape[:-1]))
    return row_length if is_picture_size(row_length, row_count) else None


def cut_batch(
    call: Call, batch: RayBatch, shape: tuple[int, ...] = (), *, most_rays: int = 0, progress: Progress | None = None
) -> Iterator[RayPiece]:
    """Yield the pieces in which a call casts a batch of rays; see `pieces.cut_rays`."""
    world = call.world
    is_small = world.memory_bytes <= MOST_SAMPLED_BYTES
    return cut_rays(
        batch, world.box, call.threads, shape=shape, tile_rows=call.session.settings.tile[1],
        finds_pictures=world.has_entry_points, chunk_limit=call.fit(PACKED_RAY, CHUNK_RAYS), most_rays=most_rays,
        count_steps=partial(_count_steps, world) if is_small else None, progress=progress,
    )  # fmt: skip


def _count_steps(world: World, batch: RayBatch) -> float:
    """Return the steps of a ray, see `pieces.cut_rays`; infinity where the host does not see the tree, as on GPUs."""
    tree = world.on_host()
    return math.inf if tree is None else count_steps(tree, world.box, batch)


def put_rays(call: Call, batch: RayBatch, piece: RayPiece, *, in_ray_order: bool = True) -> Batch:
    """Put the rays of a piece on the device.

    Parameters
    ----------
    call : Call
    batch : RayBatch
    piece : RayPiece
        Of the batch.
    in_ray_order : bool
        Whether the results are to be in the order of the chunk's rays, whatever the order of the piece; then the piece
        is the whole chunk.
    """
    count, settings = piece.ray_count, call.session.settings
    row_length = piece.row_length or count
    work_size = row_length, -(-count // row_length)
    work_group = settings.tile if piece.row_length else (settings.work_group_size, 1)
    rays = _pack_lone(call, batch, piece) if call.world.is_lone else _pack_with_lows(call, batch, piece)
    described = rays | {"ray_count": np.int32(count), "row_length": np.int32(row_length)}
    starts = AT_THE_ROOT
    if piece.is_coherent and call.world.has_entry_points:
        kernel = call.caster.kernel(TILE_KERNEL)
        starts = find_entry_points(call.session, call.world, kernel, call.take, work_size, work_group, **described)
    order = None
    if piece.order is not None and in_ray_order:
        order = call.fill("order", piece.order.dtype, count, partial(_copy, piece.order))
    return Batch(count, work_size, work_group, described | starts | {"order": order})


def _pack_lone(call: Call, batch: RayBatch, piece: RayPiece) -> dict[str, Any]:
    """Return the buffers of rays at a lone shape, by the names of the kernels' arguments."""
    rays = call.fill("rays", PACKED_RAY, piece.ray_count, _make_packer(batch, piece, call.world.box))
    return {"rays": rays, "lows": None, "low_step": np.int32(0)}


def _pack_with_lows(call: Call, batch: RayBatch, piece: RayPiece) -> dict[str, Any]:
    """Return the buffers of rays and of their low parts: one for all of them if that is enough."""
    world, count = call.world, piece.ray_count
    pack = _make_packer(batch, piece, world.box)
    shared = find_shared_low(batch, world.box, piece.begin, piece.end, reads_direction=world.advances_rays)
    if shared is not None:
        are_shared: list[bool] = []
        rays = call.fill("rays", PACKED_RAY, count, lambda *part: are_shared.append(pack(*part, shared_low=shared)))
        if all(are_shared):
            return {
                "rays": rays,
                "lows": call.fill("lows", RAY_LOW, 1, partial(_copy, shared)),
                "low_step": np.int32(0),
            }
    lows = call.take("lows", count * RAY_LOW.itemsize, for_mapping=True)
    with call.session.mapped(lows, count, RAY_LOW, write=True) as items:
        rays = call.fill(
            "rays", PACKED_RAY, count,
            lambda first, last, packed: pack(first, last, packed, lows=items[first:last]),
        )  # fmt: skip
    return {"rays": rays, "lows": lows, "low_step": np.int32(1)}


def _make_packer(batch: RayBatch, piece: RayPiece, box: TreeBox) -> Callable[..., bool]:
    """Return a function that packs a range of the piece's rays, given its begin, its end, and where they go."""
    if piece.order is None:
        return partial(_pack_in_order, batch, piece.begin, box)
    return partial(_pack_by, piece.order, batch, batch.part(piece.begin, piece.end), piece.begin, box)


def _pack_in_order(
    batch: RayBatch, begin: int, box: TreeBox, first: int, last: int, packed: NDArray[np.void], **lows: Any
) -> bool:
    rays = batch.part(begin + first, begin + last)
    return pack_rays(batch, rays, box, packed, first_ray=begin + first, **lows)


def _pack_by(
    order: NDArray[np.int32], batch: RayBatch, rays: RayRows, begin: int, box: TreeBox, first: int, last: int,
    packed: NDArray[np.void], **lows: Any,
) -> bool:  # fmt: skip
    return pack_rays(batch, rays, box, packed, order=order[first:last], first_ray=begin, **lows)


def _copy(source: NDArray[Any], first: int, last: int, target: NDArray[Any]) -> None:
    target[:] = source[first:last]

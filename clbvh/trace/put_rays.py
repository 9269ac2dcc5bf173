"""A query's rays on their way to the device: a batch is cut into pieces, and each is packed into buffers of the call.

A world with instances gets what float32 rounds off each ray as well, once for all rays where that is enough. The rays
of a coherent piece get entry points, see cl/world/starts.cl.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..structs import FAR_RADII, PACKED_RAY, RAY_LOW
from .host.walk import mean_steps
from .launch import Batch, Call
from .rays.batch import RayBatch, RayRows
from .rays.pack import NEAR_SHARE, find_shared_low, pack_rays
from .rays.pieces import CHUNK_RAYS, MOST_SAMPLED_BYTES, Progress, RayPiece, cut_rays
from .world.starts import AT_THE_ROOT, TILE_KERNEL, find_entry_points
from .world.tree_box import TreeBox
from .world.world import World

# Room for the rounding of the distance that is compared with the radius.
_ROUNDING_ROOM = 1 - 2.0**-10


def cut_batch(
    call: Call, batch: RayBatch, shape: tuple[int, ...] = (), *, part: range | None = None, most_rays: int = 0,
    progress: Progress | None = None,
) -> Iterator[RayPiece]:  # fmt: skip
    """Yield the pieces in which a call casts a batch of rays; see `pieces.cut_rays`."""
    world = call.world
    is_small = world.memory_bytes <= MOST_SAMPLED_BYTES
    return cut_rays(
        batch, world.box, call.order_by_keys, shape=shape, tile_rows=call.session.settings.tile[1],
        finds_pictures=world.has_entry_points, chunk_limit=call.fit(PACKED_RAY, CHUNK_RAYS), most_rays=most_rays,
        part=part, count_steps=partial(_count_steps, world) if is_small else None, progress=progress,
    )  # fmt: skip


def _count_steps(world: World, batch: RayBatch) -> float:
    """Return the steps of a ray, see `pieces.cut_rays`; infinity where the host does not see the tree, as on GPUs."""
    tree = world.on_host()
    return math.inf if tree is None else mean_steps(tree, world.box, batch)


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
    shared = find_shared_low(batch, world.box, piece.begin, piece.end, reads_direction=_advances_rays(world))
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


def _advances_rays(world: World) -> bool:
    """Return whether a ray may begin so far from an instance that it is advanced, see cl/instances/instance.cl."""
    assert world.top is not None
    # The centre of an instance lies in the box, and no packed ray begins farther from that along an axis.
    farthest = (NEAR_SHARE + 1) * float(world.box.half.max())
    return float(world.top.instances["radius"].min()) * FAR_RADII * _ROUNDING_ROOM < farthest


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

"""A query's rays on their way to the device: a batch is cut into pieces, and each is packed into buffers of the call.

The host casts them where they are, see `host_items.py`. What follows is for other devices.

A world with instances gets what float32 rounds off each ray as well, once for all rays where that is enough. The rays
of a coherent piece get entry points, see cl/world/starts.cl. Rays in arrays on the device are packed there, in their
own order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.info import DeviceInfo
from ..geometry.arrays import is_device_array, wait_for
from ..kinds import TRIANGLES
from ..structs import FAR_RADII, NEAR_SHARE, PACKED_RAY, RAY_LOW, STEPS, WORLD_PRIM
from ..support.say_once import say_once
from .host_items import HostItems
from .launch import Batch, Call, Caster, Query
from .rays.batch import Broadcast, RayBatch, read_vectors
from .rays.pack import explain_bad_ray, find_shared_low, pack_rays
from .rays.pieces import CHUNK_RAYS, MOST_SAMPLED_BYTES, Piece, Progress, cut_points, cut_rays
from .world.starts import AT_THE_ROOT, TILE_KERNEL, find_entry_points
from .world.tree_box import TreeBox
from .world.world import World

COUNT_STEPS = Query("count_steps", "steps", STEPS)

# Room for the rounding of the distance that is compared with the radius.
_ROUNDING_ROOM = 1 - 2.0**-10


def put_vectors(
    device: Caster, origins: ArrayLike, directions: ArrayLike, *, are_refined: bool
) -> tuple[Any, ...] | None:
    """Return origins and directions in arrays on a device, once they are written; what is there is not copied.

    None where the host is to pack the rays. It does so for a CPU, whose memory it shares, since it also sorts them and
    finds pictures: for a million rays at the dragon, kernels take 0.9 of the time for a picture, and 1.8 to 2.0 times
    as long for the same rays in mixed order (PoCL 3.0, two cores). Other reasons are said once.
    """
    session, vectors = device.session, (origins, directions)
    if host_packs(session.info):
        return None
    given = [each for each in vectors if is_device_array(each)]
    session.finish()
    for each in given:
        wait_for(each)
        if each.queue is not None:
            each.queue.finish()
    reason = ""
    if not session.info.has_fp64:
        reason = f"the device '{session.info.name}' has no double precision"
    elif not all(each.context == session.context for each in given):
        reason = "their context is not that of the tracer, `tracer.context`"
    elif are_refined and device.world.kinds != {TRIANGLES}:
        reason = "hits on spheres are computed there"
    if reason:
        say_once(f"rays or hits in arrays on a device go by way of the host: {reason}")
        return None
    read = (
        each if is_device_array(each) and each.dtype in (np.float32, np.float64) else read_vectors(each, name)
        for each, name in zip(vectors, ("origins", "directions"), strict=True)
    )
    return tuple(each if is_device_array(each) else session.make_array(each.shape, each.dtype, each) for each in read)


def host_packs(info: DeviceInfo) -> bool:
    """Return whether rays in arrays on a device are packed by the host nevertheless; see `put_vectors`."""
    return info.kind == "cpu"


def cut_batch(call: Call, batch: RayBatch, *, most_rays: int = 0, progress: Progress | None = None) -> Iterator[Piece]:
    """Yield the pieces in which a call casts a batch of rays; see `pieces.cut_rays`."""
    world = call.world
    if batch.is_on_device:
        most = call.fit(PACKED_RAY, CHUNK_RAYS)
        chunks = cut_points(batch.ray_count, most_points=most, progress=progress)
        return (Piece(begin, end) for begin, end in chunks)
    is_small = world.memory_bytes <= MOST_SAMPLED_BYTES
    return cut_rays(
        batch, world.box, call.order_by_keys, tile_rows=call.session.settings.tile[1],
        finds_pictures=world.has_entry_points, chunk_limit=call.fit(PACKED_RAY, CHUNK_RAYS), most_rays=most_rays,
        count_steps=partial(_count_steps, call) if is_small else None, progress=progress,
    )  # fmt: skip


def _count_steps(call: Call, batch: RayBatch) -> float:
    """Return the steps of a ray, see `pieces.cut_rays`; infinity where it takes long to ask, as on GPUs."""
    if not call.session.info.is_host:
        return math.inf
    # A bad ray takes no step here: it is told by its number among all of them when it is cast.
    sample = put_rays(call, batch, Piece(0, batch.ray_count))
    assert sample.here is not None
    with call.cast(COUNT_STEPS, sample._replace(here=sample.here._replace(explain=None))) as steps:
        return float(steps["node_steps"].mean() + steps["leaf_visits"].mean())


def put_rays(call: Call, batch: RayBatch, piece: Piece, *, in_ray_order: bool = True) -> Batch:
    """Put the rays of a piece on the device; the host casts them where they are.

    Parameters
    ----------
    call : Call
    batch : RayBatch
    piece : Piece
        Of the batch.
    in_ray_order : bool
        Whether the results are to be in the order of the chunk's rays, whatever the order of the piece; then the piece
        is the whole chunk.

    Raises
    ------
    QueryError
        As `pack_rays`.
    """
    if call.session.info.is_host:
        here = HostItems.of_rays(call.session.settings, call.world, batch, piece, in_ray_order=in_ray_order)
        return Batch(piece.item_count, here.groups[:2], (1, 1), {}, here=here)
    count, settings = piece.item_count, call.session.settings
    row_length = piece.row_length or count
    work_size = row_length, -(-count // row_length)
    work_group = settings.tile if piece.row_length else (settings.work_group_size, 1)
    arrays: dict[str, Any] = {}
    if batch.is_on_device:
        arrays = _put_arrays(call, batch, piece)
        rays = _pack_on_device(call, batch, piece, arrays)
    else:
        rays = _pack_lone(call, batch, piece) if call.world.low_dtype is None else _pack_with_lows(call, batch, piece)
    described = rays | {"ray_count": np.int32(count), "row_length": np.int32(row_length)}
    starts = AT_THE_ROOT
    if piece.is_coherent and call.world.has_entry_points:
        kernel = call.caster.kernel(TILE_KERNEL)
        starts = find_entry_points(call.session, call.world, kernel, call.take, work_size, work_group, **described)
    order = excluded = None
    if piece.order is not None and in_ray_order:
        order = call.fill("order", piece.order.dtype, count, partial(_copy, piece.order))
    if batch.excluded is not None:
        of_piece = batch.excluded[piece.begin : piece.end][slice(None) if piece.order is None else piece.order]
        excluded = call.fill("excluded", WORLD_PRIM, count, partial(_copy, of_piece))
    sight = {"order": order, "side": np.int32(batch.side), "excluded": excluded}
    return Batch(count, work_size, work_group, described | starts | sight, arrays)


def _put_arrays(call: Call, batch: RayBatch, piece: Piece) -> dict[str, Any]:
    """Return what kernels are told of rays in arrays, see cl/rays/arrays.cl."""
    origins, directions, t_mins, t_maxs, masks = batch.arrays
    given: dict[str, NDArray[Any]] = {"t_mins": t_mins, "t_maxs": t_maxs, "masks": masks}
    parts = {
        name: Broadcast.to_shape(values, 0, batch.shape).part(piece.begin, piece.end, values.dtype)
        for name, values in given.items()
    }
    axes = batch.device_axes(piece.begin, [*parts.values()])
    return {
        "origins": call.session.memory_of(origins),
        "directions": call.session.memory_of(directions),
        "doubles": np.int32(batch.doubles),
        "axes": call.put("axes", axes),
        "axis_count": np.int32(len(axes) - 2),
        "ray_count": np.int32(piece.item_count),
        **{name: call.put(name, part) for name, part in parts.items()},
    }


def _pack_on_device(call: Call, batch: RayBatch, piece: Piece, arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the buffers of rays in arrays, by the names of the kernels' arguments, once the device has packed them."""
    world, session, count = call.world, call.session, piece.item_count
    packed = call.take("rays", count * PACKED_RAY.itemsize, for_mapping=True)
    low = world.low_dtype
    lows = None if low is None else call.take("lows", count * low.itemsize, for_mapping=True)
    bad = np.array([count], np.int32)
    bad_buffer = call.put("bad", bad)
    kernel = session.kernel("pack_rays", {"EXACT": 1} if world.is_exact else {})
    session.run(
        kernel, (count,), (session.settings.work_group_size,), **arrays,
        box=call.put("box", world.box_numbers), rays=packed, lows=lows, bad=bad_buffer,
    )  # fmt: skip
    session.download(bad_buffer, bad)
    if bad[0] < count:
        raise explain_bad_ray(batch, piece.begin + int(bad[0]))
    return {"rays": packed, "lows": lows, "low_step": np.int32(low is not None)}


def _pack_lone(call: Call, batch: RayBatch, piece: Piece) -> dict[str, Any]:
    """Return the buffers of rays at a lone shape, by the names of the kernels' arguments."""
    rays = call.fill("rays", PACKED_RAY, piece.item_count, _make_packer(batch, piece, call.world.box))
    return {"rays": rays, "lows": None, "low_step": np.int32(0)}


def _pack_with_lows(call: Call, batch: RayBatch, piece: Piece) -> dict[str, Any]:
    """Return the buffers of rays and of their low parts: one for all of them if that is enough."""
    world, count = call.world, piece.item_count
    pack = _make_packer(batch, piece, world.box)
    low, shared = world.low_dtype, None
    assert low is not None
    if low == RAY_LOW:
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
    lows = call.take("lows", count * low.itemsize, for_mapping=True)
    with call.session.mapped(lows, count, low, write=True) as items:
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


def _make_packer(batch: RayBatch, piece: Piece, box: TreeBox) -> Callable[..., bool]:
    """Return a function that packs a range of the piece's rays, given its begin, its end, and where they go."""

    def pack(first: int, last: int, packed: NDArray[np.void], **lows: Any) -> bool:
        if piece.order is None:
            return pack_rays(batch, box, packed, first_ray=piece.begin + first, **lows)
        return pack_rays(batch, box, packed, first_ray=piece.begin, order=piece.order[first:last], **lows)

    return pack


def _copy(source: NDArray[Any], first: int, last: int, target: NDArray[Any]) -> None:
    target[:] = source[first:last]

"""Closest hits that stay on the device: rays are packed, cast and refined there, and the host sees none of them.

Spheres, and devices without double precision, are refined by the host; see cl/hits/refine.cl for what is computed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...device.session import DeviceSession
from ..launch import Call, Caster
from ..put_rays import cut_batch, put_rays
from ..rays.batch import RayBatch, check_room
from ..rays.pieces import Progress
from .closest import HIT_BYTES
from .hits import Hits
from .search import CLOSEST_HIT
from .surface import Surface


class DeviceHits(NamedTuple):
    """One hit per ray in the memory of a device; see `Tracer.closest_hit`.

    Each is a `pyopencl.array.Array` of the rays' leading shape on `Tracer.queue`, on the host a numpy array, and
    outlives the tracer. The values are those of `Hits`, to the last bit.

    Attributes
    ----------
    t, u, v : (...,) float64
    prim_id, instance_id, geometry_id : (...,) int32
        -1 on a miss.
    is_front : (...,) int8
        1 where the ray came from the side to which the normals point, 0 elsewhere and on a miss.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh, device="host") as tracer:
    ...     hits = tracer.closest_hit([[1, 2, 5], [3, 3, 5]], [0, 0, -1], out="device")
    >>> hits.t, hits.prim_id  # elsewhere `hits.t.get()` copies it to the host
    (array([ 5., inf]), array([ 0, -1], dtype=int32))
    >>> 2 * hits.u  # on the device
    array([0.5, 0. ])
    """

    t: Any
    u: Any
    v: Any
    prim_id: Any
    instance_id: Any
    geometry_id: Any
    is_front: Any

    def __repr__(self) -> str:
        return f"DeviceHits(shape={self.t.shape})"


_DTYPES = ("float64",) * 3 + ("int32",) * 3 + ("int8",)


def put_hits(session: DeviceSession, hits: Hits) -> DeviceHits:
    """Return hits on a device, of a session that owns its queue."""
    values = (np.asarray(getattr(hits, name)) for name in DeviceHits._fields)
    return DeviceHits(*map(session.make_array, [hits.shape] * len(_DTYPES), _DTYPES, values))


def find_hits_on_device(caster: Caster, rays: RayBatch, progress: Progress | None) -> DeviceHits:
    """Return the closest hits of rays in a caster's context, which are complete; the world has no spheres."""
    hits = DeviceHits(*(caster.session.make_array(rays.shape, dtype) for dtype in _DTYPES))
    # Not in the call below: with less memory for rays, the surface would not fit any better.
    with caster.open_call() as call:
        surface = call.world.refine_buffers.on(call.world.trees.session, call.session)
    written = {name: caster.session.memory_of(values) for name, values in hits._asdict().items()}

    def cast(call: Call) -> None:
        refine = call.session.kernel("refine_hits")
        for piece in cut_batch(call, rays, progress=progress):
            batch = put_rays(call, rays, piece)
            found = call.launch(CLOSEST_HIT, batch)
            size, group = (batch.item_count,), (call.session.settings.work_group_size,)
            call.session.run(
                refine, size, group, **batch.arrays, **surface, **written, found=found, found_in_world=found
            )
        # Other queues do not wait for that of the call.
        call.session.finish()

    caster.run(cast)
    return hits


def download_hits(caster: Caster, hits: DeviceHits) -> Hits:
    """Return the hits of a caster's device in the host's memory."""
    check_room(hits.t.size, HIT_BYTES)
    found = [np.empty(each.shape, each.dtype) for each in hits]
    with caster.open_call() as call:
        for values, into in zip(hits, found, strict=True):
            call.session.download(call.session.memory_of(values), into)
    t, u, v, prim_id, instance_id, _, is_front = found
    return Hits(
        t, u, v, prim_id, is_front=is_front.view(np.bool_), surface=Surface.of_world(caster.world),
        known_instance_id=None if caster.world.is_lone else instance_id,
    )  # fmt: skip

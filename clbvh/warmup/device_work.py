"""Work on a device that needs every kernel, and every function of the host that queries and pictures call."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..builders.registry import DEFAULT_BUILDER
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..rendering.render import RenderOptions, render
from ..rendering.scene import MeshSource, Scene
from ..trace import Tracer
from .host_work import TRIANGLES

# Beyond this a driver may compile a kernel once more, and batches in no order are sorted.
_MANY = 70_000

_PICTURE = (24, 32)
_SEED = 7


def cast_all(bvh: Bvh, device: DeviceInfo, layout: str, dtype: DTypeLike, *, writable: bool = True) -> None:
    """Ask a tracer for everything, with arrays of one kind: few rays, a picture's, many in no order, and points."""
    random = np.random.default_rng(_SEED)
    centre, size = bvh.mesh.origin, np.ptp(bvh.mesh.vertices, axis=0).max()

    def make(*shape: int) -> NDArray[np.floating]:
        values = (centre + size * (random.random((*shape, 3)) - 0.5)).astype(dtype)
        values.flags.writeable = writable
        return values

    with Tracer(bvh, device=device, layout=layout) as tracer:
        for shape in ((3,), _PICTURE, (_MANY,)):
            origins, directions = make(*shape), make(*shape)
            hits = tracer.closest_hit(origins, directions)
            hits.locations, hits.normals  # noqa: B018 - computed when they are asked for
            seen = hits[hits.is_hit]
            seen.offset_origins()
            seen.offset_origins(towards=seen.normals)
            tracer.closest_prim(origins, directions)
            tracer.any_hit(origins, directions)
            tracer.count_hits(origins, directions)
            crossings = tracer.all_hits(origins, directions, max_hits=4)
            crossings.locations, crossings.counts  # noqa: B018
            tracer.all_hits(origins, directions)
            tracer.hits_by_depth(origins, directions)
            tracer.hits_by_depth(origins, directions, with_locations=True)
            points = make(*shape)
            tracer.closest_point(points)
            tracer.contains(points)
            tracer.signed_distance(points)
        # From one point, and in one direction. Enough rays for a picture's are searched for its rows, in order and in
        # none.
        for shape in ((3,), _PICTURE, (_MANY,)):
            mixed = make(*shape)
            for values in (mixed, np.sort(mixed, axis=0)):
                same = np.broadcast_to(values.reshape(-1, 3)[0], values.shape)
                for origins, directions in ((same, values), (values, same)):
                    tracer.closest_hit(origins, directions)
                    tracer.any_hit(origins, directions)
        limits = np.zeros(3), np.full(3, size)
        tracer.closest_hit(make(3), make(3), t_min=limits[0], t_max=limits[1])
        vertices = bvh.mesh.vertices.astype(dtype)
        vertices.flags.writeable = writable
        tracer.update(vertices)


def draw(device: DeviceInfo, layout: str, *, validate: bool = False, builder: str = DEFAULT_BUILDER) -> None:
    """Render a small picture, and find its hits in float64."""
    scene = Scene(MeshSource(shape="knot", triangles=TRIANGLES), width=_PICTURE[1], height=_PICTURE[0])
    picture = render(scene, RenderOptions(builder=builder, device=device, layout=layout, validate=validate))
    picture.hits  # noqa: B018 - computed when they are asked for

"""A million rays and their hits in arrays on the device, against their way over the host by hand."""

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest

import clbvh
from clbvh.views.cameras.framing import frame_mesh

from .paired import compare, measure_ms

SIDE = 1000


@pytest.mark.parametrize("kind", ["picture", "mixed"])
def test_rays_and_hits_on_the_device(mesh, kind):
    origin, directions = frame_mesh(mesh, aspect=1).rays(SIDE, SIDE)
    directions = directions.reshape(-1, 3).astype(np.float32)
    if kind == "mixed":
        np.random.default_rng(0).shuffle(directions)
    origins = np.broadcast_to(origin.reshape(-1, 3), directions.shape).astype(np.float32)
    with clbvh.Tracer(mesh, device="pocl") as tracer:
        rays = [cl.array.to_device(tracer.queue, values) for values in (origins, directions)]

        def go_over_the_host():
            hits = tracer.closest_hit(*(array.get() for array in rays))
            for name in ("t", "u", "v", "prim_id"):
                cl.array.to_device(tracer.queue, getattr(hits, name))

        compare(
            f"{kind}, arrays on the device against the host",
            lambda: measure_ms(lambda: tracer.closest_hit(*rays, out="device")),
            lambda: measure_ms(go_over_the_host),
        )

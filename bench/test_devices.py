"""Two halves of a CPU as two devices, against the whole as one: what the sharing of the work costs."""

import numpy as np
import pyopencl as cl
import pytest

import clbvh
from clbvh.rendering.cameras.framing import frame_mesh

from .paired import compare, measure_ms

RAYS, SIDE = 4_000_000, 2048


def random_rays(mesh):
    generator, (lower, upper) = np.random.default_rng(0), (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
    around = generator.normal(size=(RAYS, 3))
    around *= np.linalg.norm(upper - lower) / np.linalg.norm(around, axis=1, keepdims=True)
    origins = ((lower + upper) / 2 + around).astype(np.float32)
    return origins, generator.uniform(lower, upper, (RAYS, 3)).astype(np.float32) - origins


@pytest.mark.parametrize("kind", ["random", "picture"])
def test_two_halves_beside_the_whole(mesh, kind):
    cpu = clbvh.choose_device("pocl")
    halves = cpu.cl_device.create_sub_devices([cl.device_partition_property.EQUALLY, cpu.compute_units // 2])
    rays = random_rays(mesh) if kind == "random" else frame_mesh(mesh, aspect=1).rays(SIDE, SIDE)
    bvh = clbvh.build(mesh)
    with clbvh.Tracer(bvh, device=cpu) as whole, clbvh.Tracer(bvh, device=halves[:2]) as both:
        tasks = [lambda tracer=tracer: measure_ms(lambda: tracer.closest_hit(*rays)) for tracer in (both, whole)]
        compare(f"{kind} rays, two halves against the whole", *tasks)

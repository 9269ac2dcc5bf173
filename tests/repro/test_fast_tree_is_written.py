"""A query that follows at once saw a tree that the device had not written to its end."""

import numpy as np

import clbvh


def test_rays_wait_for_a_tree_that_the_device_builds():
    mesh = clbvh.make_shape("terrain", triangles=500_000)
    random = np.random.default_rng(0)
    origins = mesh.origin + random.normal(size=(1500, 3)) * [5, 0, 5] + [0, 9, 0]
    with clbvh.Tracer(mesh) as tracer:
        expected = tracer.closest_prim(origins, [0, -1, 0.01])
    for _ in range(8):
        with clbvh.Tracer(mesh, quality="fast", layout="bvh2") as tracer:
            assert (tracer.closest_prim(origins, [0, -1, 0.01]) == expected).all()

"""How long rays take."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.render.camera import frame_points

from .paired import compare, measure_ms

WIDTH, HEIGHT = 1920, 1080


@pytest.fixture(scope="module")
def rays(mesh):
    """Primary rays of a Full HD picture: (n, 3) origins and directions, float32."""
    camera = frame_points(mesh.vertices, mesh.origin, aspect=WIDTH / HEIGHT)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    return origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("order", ["coherent", "shuffled"])
def test_closest_hit_against_open3d(mesh, rays, open3d, order):
    origins, directions = rays
    if order == "shuffled":
        shuffle = np.random.default_rng(1).permutation(len(origins))
        origins, directions = origins[shuffle], directions[shuffle]
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles((mesh.vertices + mesh.origin).astype(np.float32), mesh.faces.astype(np.uint32))
    packed = open3d.core.Tensor(np.concatenate([origins, directions], axis=1))

    with clbvh.Tracer(clbvh.build(mesh)) as tracer:

        def kernel_ms() -> float:
            before = tracer.timings_ms.get("kernel", 0.0)
            tracer.closest_hit(origins, directions)
            return tracer.timings_ms["kernel"] - before

        print(f"\n{tracer}, {tracer.memory_bytes / mesh.face_count:.0f} bytes per triangle")
        ratio = compare(
            f"{len(origins):,} {order} rays, kernel, Open3D",
            kernel_ms,
            lambda: measure_ms(lambda: scene.cast_rays(packed)),
        )
        print(f"{1 / ratio:.2f} times Open3D's rays per second")

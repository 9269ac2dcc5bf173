"""A mesh with 0.0 and -0.0 among its coordinates gave other bytes with a pool: which zero won was a matter of order."""

from __future__ import annotations

import numpy as np

from clbvh import Mesh, SubtreePool, build


def test_signed_zeros_give_the_same_bytes_with_a_pool():
    choices = np.array([-1.0, -0.0, 0.0, 1.0], np.float32)
    vertices = np.random.default_rng(0).choice(choices, size=(3000, 3))
    mesh = Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3))
    assert np.signbit(mesh.vertices[mesh.vertices == 0]).any()
    serial = build(mesh)
    with SubtreePool(workers=2) as pool:
        parallel = build(mesh, pool=pool, task_threshold=7)
    assert parallel.nodes.tobytes() == serial.nodes.tobytes()
    for field in ("aabb_min", "aabb_max"):
        zeros = serial.nodes[field][serial.nodes[field] == 0]
        assert not np.signbit(zeros).any()

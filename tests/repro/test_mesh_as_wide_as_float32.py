"""A mesh 3e38 units wide made the distances of its centroids infinite, its bins NaN, and the process crash."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, SubtreePool, Tracer, build, validate_tree


@pytest.mark.parametrize("scale", [8e37, 1e38, 3e38, 1e150])
def test_a_mesh_beyond_float32_is_built(scale):
    vertices = np.random.default_rng(0).uniform(-1, 1, (3000, 3)) * scale
    bvh = build(Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3)))
    validate_tree(bvh)
    with Tracer(bvh) as tracer:
        assert tracer.any_hit(vertices[:100] * 2, -vertices[:100]).mean() > 0.5


def test_a_pool_builds_it_too():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertices = np.concatenate([triangle - 100, triangle + 100])
    with SubtreePool(workers=1) as pool:
        mesh = Mesh.from_arrays(vertices * 3e36, [[0, 1, 2], [3, 4, 5]])
        assert build(mesh, pool=pool, task_threshold=1, leaf_size=1).node_count == 3

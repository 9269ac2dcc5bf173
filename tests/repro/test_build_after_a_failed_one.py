"""After a build that failed between two steps, workers took the next build's arrays for the ones they still held."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, SubtreePool, build, validate_tree
from clbvh.builders.processes import pool as pool_module
from clbvh.errors import PoolError


def random_mesh(seed, triangles):
    vertices = np.random.default_rng(seed).random((3 * triangles, 3))
    return Mesh.from_arrays(vertices, np.arange(3 * triangles).reshape(-1, 3))


@pytest.mark.parametrize("failing", [0, 1])
def test_a_pool_whose_build_ran_out_of_memory_builds_the_next_mesh_right(monkeypatch, failing):
    create = pool_module.SharedArray
    sizes = []

    def refuse_one_array(shape, dtype):
        sizes.append(shape)
        if len(sizes) == 1 + failing:
            raise PoolError("no memory left")
        return create(shape, dtype)

    with SubtreePool(workers=2) as pool:
        build(random_mesh(0, 500), pool=pool, task_threshold=7)
        with monkeypatch.context() as patch:
            patch.setattr(pool_module, "SharedArray", refuse_one_array)
            with pytest.raises(PoolError, match="no memory left"):
                build(random_mesh(1, 1000), pool=pool, task_threshold=7)
        bvh = build(random_mesh(2, 1000), pool=pool, task_threshold=7)
    validate_tree(bvh)

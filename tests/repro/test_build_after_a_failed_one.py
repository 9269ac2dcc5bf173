"""After a build that failed between two steps, workers took the next build's arrays for the ones they still held."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, SubtreePool, build, validate_tree
from clbvh.build.arena import Arena
from clbvh.errors import PoolError


def random_mesh(seed):
    vertices = np.random.default_rng(seed).random((3000, 3))
    return Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3))


def test_a_pool_whose_build_ran_out_of_memory_builds_the_next_mesh_right(monkeypatch):
    create = Arena.create

    def refuse_the_last_array(self, shape, dtype):
        if len(shape) == 2 and shape[1] == 8 and shape[0] != 2000:  # neither the mesh nor the scratch nodes
            raise PoolError("no memory left")
        return create(self, shape, dtype)

    with SubtreePool(workers=2) as pool:
        with monkeypatch.context() as patch:
            patch.setattr(Arena, "create", refuse_the_last_array)
            with pytest.raises(PoolError, match="no memory left"):
                build(random_mesh(1), pool=pool, task_threshold=7)
        bvh = build(random_mesh(2), pool=pool, task_threshold=7)
    validate_tree(bvh)

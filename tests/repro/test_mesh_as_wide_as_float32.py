"""A mesh 3e38 units wide made the distances of its centroids infinite, its bins NaN, and the process crash."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from clbvh import Mesh, SubtreePool, build
from clbvh.errors import MeshError

# In a process of its own, which the bug ended.
SCRIPT = """
import numpy as np, clbvh
vertices = (np.random.default_rng(0).random((3000, 3)) * 2 - 1) * {scale}
mesh = clbvh.Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3))
try:
    clbvh.validate_tree(clbvh.build(mesh))
except clbvh.errors.MeshError as error:
    print(error)
"""


@pytest.mark.parametrize(("scale", "message"), [("8e37", ""), ("1e38", "too wide"), ("3e38", "too wide")])
def test_a_mesh_is_built_or_refused(scale, message):
    run = subprocess.run([sys.executable, "-c", SCRIPT.format(scale=scale)], capture_output=True, text=True, check=True)
    assert message in run.stdout
    assert bool(message) == bool(run.stdout)


def test_a_pool_refuses_it_too_and_stays_usable():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertices = np.concatenate([triangle - 100, triangle + 100])
    faces = [[0, 1, 2], [3, 4, 5]]
    with SubtreePool(workers=1) as pool:
        with pytest.raises(MeshError, match="larger unit"):
            build(Mesh.from_arrays(vertices * 3e36, faces), pool=pool, task_threshold=1)
        bvh = build(Mesh.from_arrays(vertices, faces), pool=pool, task_threshold=1, leaf_size=1)
        assert bvh.node_count == 3

"""`traversal_cost=2` instead of `2.0` made numba compile the whole builder once more."""

from __future__ import annotations

import numpy as np

from clbvh import Mesh, build
from clbvh.builders.sah.subtree import build_subtree


def test_any_kind_of_number_uses_the_same_compiled_code():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    build(mesh)
    compiled = len(build_subtree.signatures)
    build(mesh, traversal_cost=2, bins=np.int32(8), leaf_size=np.uint8(2))
    build(mesh, traversal_cost=np.float32(2))
    assert len(build_subtree.signatures) == compiled

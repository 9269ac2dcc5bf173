"""The corners of the leaves' triangles, as each layout stores them."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.layouts.leaf_blocks import gather_blocks
from clbvh.structs import NO_PRIM, TRIANGLE, TRIANGLE_BLOCKS

from ...soup import make_soup
from ..hand_made import make_mesh


def test_triangles_stand_in_the_order_asked_for():
    mesh = make_soup(50, seed=3)
    order = np.random.default_rng(3).permutation(50).astype(np.int32)
    triangles = gather_blocks(mesh, order.reshape(-1, 1))
    assert triangles.dtype == TRIANGLE
    for index, prim in enumerate(order):
        assert triangles["prim_id"][index] == prim
        for corner, name in enumerate("abc"):
            assert triangles[name][index].tolist() == mesh.local_vertices[mesh.faces[prim, corner]].tolist()


def test_some_of_the_triangles_and_none():
    mesh = make_mesh()
    assert gather_blocks(mesh, np.array([[3], [1]], np.int32))["prim_id"].tolist() == [3, 1]
    assert len(gather_blocks(mesh, np.empty((0, 1), np.int32))) == 0


def test_degenerate_triangles_collapse_into_their_first_corner():
    line = [[0, 0, 0], [1, 2, 3], [2, 4, 6], [5, 0, 0]]
    mesh = Mesh.from_arrays(line, [[1, 0, 2], [0, 1, 3], [3, 3, 1], [2, 2, 2]])
    triangles = gather_blocks(mesh, np.arange(4, dtype=np.int32).reshape(-1, 1))
    for prim, collapsed in enumerate([True, False, True, True]):
        corners = [triangles[name][prim].tolist() for name in "abc"]
        assert corners[0] == mesh.local_vertices[mesh.faces[prim, 0]].tolist()
        assert (corners[0] == corners[1] == corners[2]) == collapsed


@pytest.mark.parametrize("width", list(TRIANGLE_BLOCKS))
def test_blocks_have_the_corners_of_their_triangles(width):
    corners = np.random.default_rng(70).uniform(-1, 1, (5, 3, 3))
    corners[2, 1] = corners[2, 0]
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(15).reshape(-1, 3))
    blocks = np.full((2, width), NO_PRIM, np.int32)
    blocks[0, :3], blocks[1, :2] = [4, 2, 0], [1, 3]
    gathered = gather_blocks(mesh, blocks)
    assert gathered.dtype == TRIANGLE_BLOCKS[width]
    np.testing.assert_array_equal(gathered["prim_id"], blocks)
    for block, lane in np.ndindex(blocks.shape):
        prim = blocks[block, lane]
        found = gathered["corners"][block, :, :, lane]
        # No ray hits a lane without a triangle, or a degenerate triangle.
        if prim in (NO_PRIM, 2):
            assert np.isnan(found).all()
        else:
            np.testing.assert_array_equal(found, mesh.local_vertices[mesh.faces[prim]])

"""What the device gets, against a walk in plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, build
from clbvh.layout import BVH2_NODE, TRIANGLE
from clbvh.tree.layouts import gather_triangles, make_bvh2_nodes

from ..soup import make_soup
from .hand_made import make_leaf, make_mesh, make_tree


def walk_both(bvh, nodes):
    """Walk tree and layout side by side; return how many bvh2 nodes were seen."""
    rows = bvh.nodes
    seen = set()
    waiting = [(0, 0)]
    while waiting:
        row, number = waiting.pop()
        assert number not in seen
        seen.add(number)
        for side in range(2):
            child = rows[rows[row]["first"] + side]
            assert nodes["aabb_min"][number, side].tobytes() == child["aabb_min"].tobytes()
            assert nodes["aabb_max"][number, side].tobytes() == child["aabb_max"].tobytes()
            assert nodes["count"][number, side] == child["count"]
            if child["count"] > 0:
                assert nodes["first"][number, side] == child["first"]
            else:
                waiting.append((rows[row]["first"] + side, nodes["first"][number, side]))
    return len(seen)


def test_the_hand_made_tree_in_full():
    nodes = make_bvh2_nodes(make_tree())
    assert nodes.dtype == BVH2_NODE
    expected = np.array(
        [
            ([[0, 0, 0], [2, 0, 1]], [[5, 1, 2], [7, 1, 3]], [0, 1], [2, 0]),
            ([[6, 0, 3], [2, 0, 1]], [[7, 1, 3], [3, 1, 1]], [2, 3], [1, 1]),
        ],
        BVH2_NODE,
    )
    assert nodes.tobytes() == expected.tobytes()


@pytest.mark.parametrize("count", [2, 3, 5, 100, 3000])
@pytest.mark.parametrize("leaf_size", [1, 4])
def test_a_walk_meets_the_same_boxes_and_leaves(count, leaf_size):
    bvh = build(make_soup(count, seed=count), leaf_size=leaf_size)
    if bvh.node_count == 1:
        pytest.fail("the case must have an interior node")
    nodes = make_bvh2_nodes(bvh)
    assert len(nodes) == bvh.node_count // 2
    assert walk_both(bvh, nodes) == len(nodes)


@pytest.mark.parametrize("count", [1, 4])
def test_a_tree_of_one_leaf_has_a_second_child_that_no_ray_meets(count):
    bvh = make_leaf(count)
    nodes = make_bvh2_nodes(bvh)
    assert len(nodes) == 1
    assert (nodes["first"][0, 0], nodes["count"][0, 0]) == (0, count)
    assert nodes["aabb_min"][0, 0].tolist() == bvh.nodes["aabb_min"][0].tolist()
    assert nodes["aabb_max"][0, 0].tolist() == bvh.nodes["aabb_max"][0].tolist()
    # Its box is turned inside out.
    assert (nodes["aabb_min"][0, 1] == np.finfo(np.float32).max).all()
    assert (nodes["aabb_max"][0, 1] == -np.finfo(np.float32).max).all()
    assert (nodes["first"][0, 1], nodes["count"][0, 1]) == (0, count)


def test_nodes_may_lie_apart_in_memory():
    bvh = make_tree()
    spread = np.zeros(2 * bvh.node_count, bvh.nodes.dtype)
    spread[::2] = bvh.nodes
    apart = type(bvh)(spread[::2], bvh.prim_ids, bvh.mesh)
    assert make_bvh2_nodes(apart).tobytes() == make_bvh2_nodes(bvh).tobytes()


def test_triangles_stand_in_the_order_asked_for():
    mesh = make_soup(50, seed=3)
    order = np.random.default_rng(3).permutation(50).astype(np.int32)
    triangles = gather_triangles(mesh, order)
    assert triangles.dtype == TRIANGLE
    for place, prim in enumerate(order):
        assert triangles["prim_id"][place] == prim
        for corner, name in enumerate("abc"):
            assert triangles[name][place].tolist() == mesh.vertices[mesh.faces[prim, corner]].tolist()


def test_some_of_the_triangles_and_none():
    mesh = make_mesh()
    assert gather_triangles(mesh, np.array([3, 1], np.int32))["prim_id"].tolist() == [3, 1]
    assert len(gather_triangles(mesh, np.array([], np.int32))) == 0


def test_degenerate_triangles_collapse_into_their_first_corner():
    line = [[0, 0, 0], [1, 2, 3], [2, 4, 6], [5, 0, 0]]
    mesh = Mesh.from_arrays(line, [[1, 0, 2], [0, 1, 3], [3, 3, 1], [2, 2, 2]])
    triangles = gather_triangles(mesh, np.arange(4, dtype=np.int32))
    for prim, collapsed in enumerate([True, False, True, True]):
        corners = [triangles[name][prim].tolist() for name in "abc"]
        assert corners[0] == mesh.vertices[mesh.faces[prim, 0]].tolist()
        assert (corners[0] == corners[1] == corners[2]) == collapsed

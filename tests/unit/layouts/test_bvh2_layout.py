"""The layout bvh2, against a walk in plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import build
from clbvh.layouts.device_arrays import make_bvh2_nodes
from clbvh.structs import BVH2_NODE

from ...soup import make_soup
from ..hand_made import make_leaf, make_tree


def walk_both(bvh, bvh2_nodes):
    """Walk tree and layout side by side; return the number of bvh2 nodes seen."""
    nodes = bvh.nodes
    seen = set()
    stack = [(0, 0)]
    while stack:
        node, bvh2_node = stack.pop()
        assert bvh2_node not in seen
        seen.add(bvh2_node)
        for side in range(2):
            child = nodes[nodes[node]["first"] + side]
            assert bvh2_nodes["aabb_min"][bvh2_node, side].tobytes() == child["aabb_min"].tobytes()
            assert bvh2_nodes["aabb_max"][bvh2_node, side].tobytes() == child["aabb_max"].tobytes()
            assert bvh2_nodes["count"][bvh2_node, side] == child["count"]
            if child["count"] > 0:
                assert bvh2_nodes["first"][bvh2_node, side] == child["first"]
            else:
                stack.append((nodes[node]["first"] + side, bvh2_nodes["first"][bvh2_node, side]))
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
    # Its box is inverted.
    assert (nodes["aabb_min"][0, 1] == np.finfo(np.float32).max).all()
    assert (nodes["aabb_max"][0, 1] == -np.finfo(np.float32).max).all()
    assert (nodes["first"][0, 1], nodes["count"][0, 1]) == (0, count)


def test_nodes_may_lie_apart_in_memory():
    bvh = make_tree()
    spread = np.zeros(2 * bvh.node_count, bvh.nodes.dtype)
    spread[::2] = bvh.nodes
    apart = type(bvh)(spread[::2], bvh.prim_ids, bvh.mesh)
    assert make_bvh2_nodes(apart).tobytes() == make_bvh2_nodes(bvh).tobytes()

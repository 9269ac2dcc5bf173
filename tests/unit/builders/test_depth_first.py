"""The indices of a tree that is made of a top and of finished subtrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from clbvh.builders.invariants import WHOLE_TREE, Placement, index_of, order_top, place_subtree, place_top
from clbvh.structs import NODE, NODE_LANES


@dataclass
class Node:
    children: tuple = ()
    node_count: int = 1
    placement: Placement = WHOLE_TREE


def grow(random, levels):
    """Return a random binary tree."""
    if levels == 0 or random.random() < 0.2:
        return Node()
    return Node((grow(random, levels - 1), grow(random, levels - 1)))


def count_nodes(node):
    return 1 + sum(count_nodes(child) for child in node.children)


def index_all(node, index, below, indices):
    """Note the index of each node of a whole tree; return the next free one."""
    indices[id(node)] = index, below
    next_index = below + 2 if node.children else below
    for number, child in enumerate(node.children):
        next_index = index_all(child, below + number, next_index, indices)
    return next_index


def cut(node, levels):
    """Return the top of a tree as new nodes, and pairs of a node of the top and its origin."""
    if levels == 0 or not node.children:
        leaf = Node(node_count=count_nodes(node))
        return leaf, [(leaf, node)]
    (left, left_pairs), (right, right_pairs) = (cut(child, levels - 1) for child in node.children)
    top = Node((left, right), node_count=0)
    return top, [(top, node), *left_pairs, *right_pairs]


@pytest.mark.parametrize("seed", range(20))
def test_a_top_has_the_indices_of_the_whole_tree(seed):
    tree = grow(np.random.default_rng(seed), 8)
    indices = {}
    node_count = index_all(tree, 0, 1, indices)
    for levels in range(9):
        top, pairs = cut(tree, levels)
        assert place_top(top) == node_count == count_nodes(tree)
        for node, origin in pairs:
            assert node.placement == indices[id(origin)]


def test_a_top_may_be_one_leaf():
    placements, node_count = order_top(np.array([0]), np.array([7]))
    assert placements.tolist() == [[0, 1]]
    assert node_count == 7


def test_the_nodes_of_a_subtree_are_one_block_apart_from_its_root():
    assert [index_of(number, Placement(5, 20)) for number in range(4)] == [5, 20, 21, 22]


def test_a_subtree_keeps_its_boxes_and_names_its_children_anew():
    source = np.zeros(10, NODE)
    source["aabb_min"][:, 0] = np.arange(10)
    source["first"][3:8], source["count"][3:8] = [4, 0, 6, 2, 3], [0, 2, 0, 1, 1]
    nodes = np.full((30, NODE_LANES), -1, np.float32)
    place_subtree(source.view(np.float32).reshape(-1, NODE_LANES), 3, 5, 100, Placement(9, 20), nodes)
    placed = nodes.view(NODE).reshape(-1)
    assert placed["aabb_min"][[9, 20, 21, 22, 23], 0].tolist() == [3, 4, 5, 6, 7]
    assert placed["first"][[9, 20, 21, 22, 23]].tolist() == [20, 100, 22, 102, 103]
    assert placed["count"][[9, 20, 21, 22, 23]].tolist() == [0, 2, 0, 1, 1]
    assert (np.delete(nodes, [9, 20, 21, 22, 23], axis=0) == -1).all()

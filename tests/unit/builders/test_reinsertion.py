"""Expanding, moving and collapsing: each step alone, on trees that are small enough to try everything."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh import Bvh, Mesh, build, sah_cost, validate_tree
from clbvh.builders.prim_refs import fill_slice
from clbvh.builders.reinsertion.expanded_tree import (
    ROOT,
    ExpandedTree,
    choose_leaves,
    collapse,
    count_prims,
    expand_leaves,
    list_descendants,
    sweep,
)
from clbvh.builders.reinsertion.reinsert import reinsert_below
from clbvh.bvh.refit import fit_nodes
from clbvh.geometry.corners import find_corners
from clbvh.structs import EXPANDED_FIRST, EXPANDED_PRIM_ID, NODE

from ...soup import make_soup
from ..hand_made import FACE_COUNT, make_leaf, make_mesh, make_tree


def make_prim_refs(mesh):
    prim_refs = np.empty((mesh.face_count, 8), np.float32)
    fill_slice(find_corners(mesh), 0, mesh.face_count, prim_refs)
    return prim_refs


def expand(bvh):
    """Return the expanded tree."""
    count = bvh.mesh.face_count
    boxes = np.zeros((2 * count, 8), np.float32)
    tree = ExpandedTree(boxes, boxes.view(np.int32), np.zeros(count, np.int32))
    nodes = bvh.nodes.view(np.float32).reshape(-1, 8)
    expand_leaves(nodes, nodes.view(np.int32), bvh.prim_ids, make_prim_refs(bvh.mesh), tree)
    return tree


def list_below(tree, top):
    below = np.empty(len(tree.links), np.int32)
    return below[: list_descendants(tree.links, top, below)]


def list_all(tree):
    return np.concatenate(([ROOT], list_below(tree, ROOT))).astype(np.int32)


def collapse_marked(mesh, tree, is_leaf):
    nodes, prim_ids = np.zeros_like(tree.boxes), np.empty(mesh.face_count, np.int32)
    node_count = collapse(tree, is_leaf, nodes, nodes.view(np.int32), prim_ids)
    return Bvh(nodes[:node_count].copy().view(NODE).reshape(-1), prim_ids, mesh)


def collapse_best(mesh, tree, leaf_size=1, traversal_cost=1.0):
    is_leaf = np.empty(len(tree.boxes), np.bool_)
    depth = choose_leaves(tree, leaf_size, traversal_cost, list_all(tree), is_leaf)
    bvh = collapse_marked(mesh, tree, is_leaf)
    assert bvh.depth == depth
    validate_tree(bvh, max_leaf_size=leaf_size)
    return bvh


def assert_linked(tree):
    """Every node but the unused one is below the root once, and knows its parent."""
    order = list_all(tree)
    assert sorted(order.tolist()) == list(range(1, len(tree.boxes)))
    children = tree.links[order, EXPANDED_FIRST]
    for node in order[children != 0]:
        assert tree.parents[tree.links[node, EXPANDED_FIRST] >> 1] == node
    assert sorted(tree.links[order[children == 0], EXPANDED_PRIM_ID].tolist()) == list(range(len(tree.parents)))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("count", [1, 2, 3, 40, 700])
def test_a_tree_of_single_triangles_comes_back_as_it_was(count, seed):
    bvh = build(make_soup(count, seed), leaf_size=1)
    tree = expand(bvh)
    assert_linked(tree)
    again = collapse_best(bvh.mesh, tree)
    assert again.nodes.tobytes() == bvh.nodes.tobytes()
    assert again.prim_ids.tobytes() == bvh.prim_ids.tobytes()


@pytest.mark.parametrize("make", [make_tree, make_leaf])
def test_leaves_are_split_down_to_single_triangles(make):
    bvh = make()
    tree = expand(bvh)
    assert_linked(tree)
    assert count_prims(tree.links, list_all(tree))[ROOT] == FACE_COUNT
    collapse_best(bvh.mesh, tree)


@pytest.mark.parametrize("seed", [5])
@pytest.mark.parametrize("count", [2, 3, 9, 255])
def test_a_sweep_finds_the_cheapest_split_of_all(count, seed):
    prim_refs = make_prim_refs(make_soup(count, seed, grid=40))
    prims = np.arange(count, dtype=np.int32)
    left = sweep(prims, prim_refs, np.empty((3, count), np.int32), np.empty(count))
    assert sorted(prims.tolist()) == list(range(count))

    def cost_of(chosen):
        size = -(prim_refs[chosen, 4:7].min(axis=0) + prim_refs[chosen, :3].min(axis=0)).astype(np.float64)
        return (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]) * len(chosen)

    costs = [
        cost_of(order[:cut]) + cost_of(order[cut:])
        for axis in range(3)
        for order in [np.argsort(prim_refs[:, axis] - prim_refs[:, 4 + axis], kind="stable")]
        for cut in range(1, count)
    ]
    assert cost_of(prims[:left]) + cost_of(prims[left:]) == pytest.approx(min(costs))


def test_equal_triangles_are_split_evenly():
    mesh = Mesh.from_arrays(np.eye(3), np.tile(np.arange(3), (64, 1)))
    left = sweep(np.arange(64, dtype=np.int32), make_prim_refs(mesh), np.empty((3, 64), np.int32), np.empty(64))
    assert left == 32


def test_neighbours_that_were_parted_find_each_other():
    # Four triangles in a row as (0, (1, 3)), 2: 3 belongs to 2.
    leaves = {1: (2, 3), 3: (0, 0), 5: (1, 1), 6: (3, 2)}  # node: (face, index in prim_ids)
    nodes = np.zeros(7, NODE)
    nodes["first"][[0, 2, 4]] = 1, 3, 5
    prim_ids = np.empty(FACE_COUNT, np.int32)
    for leaf, (face, index) in leaves.items():
        nodes["first"][leaf], nodes["count"][leaf], prim_ids[index] = index, 1, face
    mesh = make_mesh()
    tree = expand(Bvh(fit_nodes(nodes["first"], nodes["count"], prim_ids, mesh), prim_ids, mesh))
    below = list_below(tree, ROOT)
    leaf_of = {tree.links[node, EXPANDED_PRIM_ID]: node for node in below if tree.links[node, EXPANDED_FIRST] == 0}
    # 2 would move to 3, but the root would go with it.
    assert reinsert_below(tree, ROOT, np.array([leaf_of[2]], np.int32)) == 0
    node = leaf_of[3]
    assert reinsert_below(tree, ROOT, np.array([node], np.int32)) == 1
    assert_linked(tree)
    bvh = collapse_best(mesh, tree)
    pairs = [bvh.prim_ids[begin : begin + 2].tolist() for begin in (0, 2)]
    assert sorted(map(sorted, pairs)) == [[0, 1], [2, 3]]
    assert bvh.depth == 2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_move_lowers_the_cost(seed):
    mesh = make_soup(600, seed, grid=100, size=60)
    tree = expand(build(mesh, bins=2, leaf_size=1))
    before = sah_cost(collapse_best(mesh, tree))
    for node in list_below(tree, ROOT):
        moves = reinsert_below(tree, ROOT, np.array([node], np.int32))
        after = sah_cost(collapse_best(mesh, tree))
        assert after < before if moves else after == before
        before = after
    assert_linked(tree)


def test_a_subtree_keeps_to_its_own_nodes():
    mesh = make_soup(500, 4, grid=50, size=30)
    tree = expand(build(mesh))
    top = int(tree.links[ROOT, EXPANDED_FIRST])
    below = list_below(tree, top)
    others = np.setdiff1d(np.arange(len(tree.boxes)), below)
    untouched = tree.links[others].copy()
    assert reinsert_below(tree, top, below) > 0
    assert (tree.links[others] == untouched).all()
    assert sorted(list_below(tree, top).tolist()) == sorted(below.tolist())
    collapse_best(mesh, tree)


@pytest.mark.parametrize("seed", [1, 7])
@pytest.mark.parametrize("traversal_cost", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("leaf_size", [1, 2, 4, 8])
def test_the_leaves_are_the_cheapest_of_all(leaf_size, traversal_cost, seed):
    mesh = make_soup(9, seed, grid=10, size=12)
    tree = expand(build(mesh, leaf_size=1))
    best = sah_cost(collapse_best(mesh, tree, leaf_size, traversal_cost), traversal_cost=traversal_cost)

    # All ways to make leaves of some interior nodes.
    interior = [node for node in list_all(tree) if tree.links[node, EXPANDED_FIRST] != 0]
    costs = []
    for chosen in itertools.product([False, True], repeat=len(interior)):
        is_leaf = tree.links[:, EXPANDED_FIRST] == 0
        is_leaf[interior] = chosen
        bvh = collapse_marked(mesh, tree, is_leaf)
        if bvh.nodes["count"].max() <= leaf_size:
            costs.append(sah_cost(bvh, traversal_cost=traversal_cost))
    assert best == pytest.approx(min(costs))


def test_of_equal_costs_the_leaf_is_taken():
    """Boxes without area cost nothing, however they are divided."""
    mesh = Mesh.from_arrays([[x, 0, 0] for x in range(12)], np.arange(12).reshape(-1, 3))
    tree = expand(build(mesh, leaf_size=1))
    assert collapse_best(mesh, tree, 4, 1.0).nodes["count"].tolist() == [4]

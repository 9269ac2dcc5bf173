"""The quality `high`: each step alone on trees that are small enough to try everything, and what it is worth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh import BuildOptions, Bvh, Mesh, build, sah_cost, validate_tree
from clbvh.builders.reinsertion import build_high
from clbvh.builders.reinsertion.build_high import REINSERTION, ROOT, ExpandedTree
from clbvh.bvh.refit import fit_nodes
from clbvh.structs import BOX_TAG, BOX_TALLY, NODE

from ...soup import make_soup
from ..hand_made import make_mesh
from .reference import cost_of, make_prim_refs
from .shapes import copies


def list_all(tree):
    return tree.list_nodes(np.empty(len(tree.boxes), np.int32))


def reinsert(tree, *nodes):
    return REINSERTION.reinsert_below(*tree, ROOT, np.array(nodes, np.int32))


def collapse_best(mesh, tree, leaf_size=1, traversal_cost=1.0):
    options = BuildOptions(leaf_size=leaf_size, traversal_cost=traversal_cost)
    depth, is_leaf = tree.choose_leaves(list_all(tree), options)
    bvh = tree.collapse(is_leaf, mesh)
    assert bvh.depth == depth
    validate_tree(bvh, max_leaf_size=leaf_size)
    return bvh


def assert_linked(tree):
    """Every node but the unused one is below the root once, and knows its parent."""
    order = list_all(tree)
    assert sorted(order.tolist()) == list(range(1, len(tree.boxes)))
    children = tree.links[order, BOX_TAG]
    assert (tree.parents[children[children != 0] >> 1] == order[children != 0]).all()
    assert sorted(tree.links[order[children == 0], BOX_TALLY].tolist()) == list(range(len(tree.parents)))


def test_a_sweep_finds_the_cheapest_split_and_the_most_even_of_equal_ones():
    for mesh in (*(make_soup(count, seed=5, grid=40) for count in (2, 3, 9, 255)), copies(64)):
        rows, count = make_prim_refs(mesh)[0][0], mesh.face_count
        prims = np.arange(count, dtype=np.int32)
        left = REINSERTION.sweep(prims, rows)
        costs = [
            cost_of(order[:cut]) + cost_of(order[cut:])
            for axis in range(3)
            for order in [rows[np.argsort(rows[:, axis] - rows[:, 4 + axis], kind="stable")]]
            for cut in range(1, count)
        ]
        rows = rows[prims]
        assert cost_of(rows[:left]) + cost_of(rows[left:]) == pytest.approx(min(costs))
        assert sorted(prims.tolist()) == list(range(count))
    assert left == 32


def test_neighbours_that_were_parted_find_each_other():
    # Four triangles in a row as (0, (1, 3)), 2: 3 belongs to 2.
    nodes, prim_ids, mesh = np.zeros(7, NODE), np.array([0, 1, 3, 2], np.int32), make_mesh()
    nodes["first"], nodes["count"] = [1, 3, 3, 0, 5, 1, 2], [0, 0, 1, 1, 0, 1, 1]
    tree = ExpandedTree.of(Bvh(fit_nodes(nodes["first"], nodes["count"], prim_ids, mesh), prim_ids, mesh))
    below = list_all(tree)[1:]
    leaf_of = {tree.links[node, BOX_TALLY]: node for node in below if tree.links[node, BOX_TAG] == 0}
    # 2 would move to 3, but the root would go with it.
    assert reinsert(tree, leaf_of[2]) == 0
    assert reinsert(tree, leaf_of[3]) == 1
    assert_linked(tree)
    bvh = collapse_best(mesh, tree)
    assert sorted(sorted(bvh.prim_ids[begin : begin + 2]) for begin in (0, 2)) == [[0, 1], [2, 3]]
    assert bvh.depth == 2


def test_every_move_lowers_the_cost():
    mesh = make_soup(600, seed=0, grid=100, size=60)
    tree = ExpandedTree.of(build(mesh, bins=2, leaf_size=1))
    before = sah_cost(collapse_best(mesh, tree))
    for node in list_all(tree)[1:]:
        moves = reinsert(tree, node)
        after = sah_cost(collapse_best(mesh, tree))
        assert after < before if moves else after == before
        before = after
    assert_linked(tree)


@pytest.mark.parametrize(("leaf_size", "traversal_cost"), [(2, 1.0), (4, 0.3), (4, 4.0)])
def test_the_leaves_are_the_cheapest_of_all(leaf_size, traversal_cost):
    mesh = make_soup(9, seed=7, grid=10, size=12)
    tree = ExpandedTree.of(build(mesh, leaf_size=1))
    best = sah_cost(collapse_best(mesh, tree, leaf_size, traversal_cost), traversal_cost=traversal_cost)
    # All ways to make leaves of some interior nodes.
    interior = [node for node in list_all(tree) if tree.links[node, BOX_TAG] != 0]
    costs = []
    for chosen in itertools.product([False, True], repeat=len(interior)):
        is_leaf = tree.links[:, BOX_TAG] == 0
        is_leaf[interior] = chosen
        bvh = tree.collapse(is_leaf, mesh)
        if bvh.nodes["count"].max() <= leaf_size:
            costs.append(sah_cost(bvh, traversal_cost=traversal_cost))
    assert best == pytest.approx(min(costs))


def test_of_equal_costs_the_leaf_is_taken():
    """Boxes without area cost nothing, however they are divided."""
    mesh = Mesh.from_arrays([[x, 0, 0] for x in range(12)], np.arange(12).reshape(-1, 3))
    tree = ExpandedTree.of(build(mesh, leaf_size=1))
    assert collapse_best(mesh, tree, 4, 1.0).nodes["count"].tolist() == [4]


def test_a_tree_that_would_be_too_deep_is_given_up(mesh, monkeypatch):
    plain = build(mesh, bins=16)
    monkeypatch.setattr(build_high, "MAX_DEPTH", 3)
    high = build(mesh, bins=16, quality="high")
    assert (high.nodes.tobytes(), high.prim_ids.tobytes()) == (plain.nodes.tobytes(), plain.prim_ids.tobytes())

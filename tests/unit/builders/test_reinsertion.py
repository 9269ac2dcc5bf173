"""Unfolding, moving and folding: each step alone, on trees that are small enough to try everything."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh import Bvh, Mesh, build, sah_cost, validate_tree
from clbvh.build.fold import choose_leaves, fold
from clbvh.build.metadata import record_slice
from clbvh.build.reinsertion import count_prims, list_rows, reinsert_below
from clbvh.build.unfold import LINK, PRIM, ROOT, sweep, unfold
from clbvh.layout import NODE
from clbvh.tree.refit import fit_nodes

from ..soup import make_soup
from .hand_made import FACE_COUNT, make_leaf, make_mesh, make_tree


def make_records(mesh):
    records = np.empty((mesh.face_count, 8), np.float32)
    record_slice(mesh, 0, mesh.face_count, records)
    return records


def unfold_tree(bvh):
    """Return rows, links and parents."""
    count = bvh.mesh.face_count
    rows, parents = np.zeros((2 * count, 8), np.float32), np.zeros(count, np.int32)
    nodes = bvh.nodes.view(np.float32).reshape(-1, 8)
    links = rows.view(np.int32)
    unfold(nodes, nodes.view(np.int32), bvh.prim_ids, make_records(bvh.mesh), rows, links, parents)
    return rows, links, parents


def list_below(links, top):
    below = np.empty(len(links), np.int32)
    return below[: list_rows(links, top, below)]


def list_all(links):
    return np.concatenate(([ROOT], list_below(links, ROOT))).astype(np.int32)


def fold_tree(mesh, rows, links, leaf_size=1, traversal_cost=1.0):
    is_leaf = np.empty(len(rows), np.bool_)
    depth = choose_leaves(rows, links, leaf_size, traversal_cost, list_all(links), is_leaf)
    nodes, prim_ids = np.zeros((len(rows), 8), np.float32), np.empty(mesh.face_count, np.int32)
    row_count = fold(rows, links, is_leaf, nodes, nodes.view(np.int32), prim_ids)
    bvh = Bvh(nodes[:row_count].copy().view(NODE).reshape(-1), prim_ids, mesh)
    assert bvh.depth == depth
    validate_tree(bvh, max_leaf_size=leaf_size)
    return bvh


def assert_linked(rows, links, parents):
    """Every row but the unused one is below the root once, and knows its parent."""
    order = list_all(links)
    assert sorted(order.tolist()) == list(range(1, len(rows)))
    for row in order[links[order, LINK] != 0]:
        assert parents[links[row, LINK] >> 1] == row
    leaves = order[links[order, LINK] == 0]
    assert sorted(links[leaves, PRIM].tolist()) == list(range(len(rows) // 2))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("count", [1, 2, 3, 40, 700])
def test_a_tree_of_single_triangles_comes_back_as_it_was(count, seed):
    bvh = build(make_soup(count, seed), leaf_size=1)
    rows, links, parents = unfold_tree(bvh)
    assert_linked(rows, links, parents)
    again = fold_tree(bvh.mesh, rows, links)
    assert again.nodes.tobytes() == bvh.nodes.tobytes()
    assert again.prim_ids.tobytes() == bvh.prim_ids.tobytes()


@pytest.mark.parametrize("make", [make_tree, make_leaf])
def test_leaves_are_cut_down_to_single_triangles(make):
    bvh = make()
    rows, links, parents = unfold_tree(bvh)
    assert_linked(rows, links, parents)
    assert (count_prims(links, list_all(links))[ROOT]) == FACE_COUNT
    fold_tree(bvh.mesh, rows, links)


@pytest.mark.parametrize("seed", [5])
@pytest.mark.parametrize("count", [2, 3, 9, 255])
def test_a_sweep_finds_the_cheapest_cut_of_all(count, seed):
    records = make_records(make_soup(count, seed, grid=40))
    prims = np.arange(count, dtype=np.int32)
    left = sweep(prims, records, np.empty((3, count), np.int32), np.empty(count))
    assert sorted(prims.tolist()) == list(range(count))

    def cost_of(chosen):
        size = -(records[chosen, 4:7].min(axis=0) + records[chosen, :3].min(axis=0)).astype(np.float64)
        return (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]) * len(chosen)

    costs = [
        cost_of(order[:cut]) + cost_of(order[cut:])
        for axis in range(3)
        for order in [np.argsort(records[:, axis] - records[:, 4 + axis], kind="stable")]
        for cut in range(1, count)
    ]
    assert cost_of(prims[:left]) + cost_of(prims[left:]) == pytest.approx(min(costs))


def test_equal_triangles_are_cut_evenly():
    mesh = Mesh.from_arrays(np.eye(3), np.tile(np.arange(3), (64, 1)))
    left = sweep(np.arange(64, dtype=np.int32), make_records(mesh), np.empty((3, 64), np.int32), np.empty(64))
    assert left == 32


def test_neighbours_that_were_parted_find_each_other():
    # Four triangles in a row as (0, (1, 3)), 2: 3 belongs to 2.
    leaves = {1: (2, 3), 3: (0, 0), 5: (1, 1), 6: (3, 2)}  # row: (face, place)
    nodes = np.zeros(7, NODE)
    nodes["first"][[0, 2, 4]] = 1, 3, 5
    prim_ids = np.empty(FACE_COUNT, np.int32)
    for row, (face, place) in leaves.items():
        nodes["first"][row], nodes["count"][row], prim_ids[place] = place, 1, face
    mesh = make_mesh()
    rows, links, parents = unfold_tree(Bvh(fit_nodes(nodes["first"], nodes["count"], prim_ids, mesh), prim_ids, mesh))
    below = list_below(links, ROOT)
    (node,) = below[(links[below, LINK] == 0) & (links[below, PRIM] == 3)]
    assert reinsert_below(rows, links, parents, ROOT, np.array([node], np.int32)) == 1
    assert_linked(rows, links, parents)
    bvh = fold_tree(mesh, rows, links)
    pairs = [bvh.prim_ids[begin : begin + 2].tolist() for begin in (0, 2)]
    assert sorted(map(sorted, pairs)) == [[0, 1], [2, 3]]
    assert bvh.depth == 2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_move_lowers_the_cost(seed):
    mesh = make_soup(600, seed, grid=100, size=60)
    rows, links, parents = unfold_tree(build(mesh, bins=2, leaf_size=1))
    before = sah_cost(fold_tree(mesh, rows, links))
    for node in list_below(links, ROOT):
        moves = reinsert_below(rows, links, parents, ROOT, np.array([node], np.int32))
        after = sah_cost(fold_tree(mesh, rows, links))
        assert after < before if moves else after == before
        before = after
    assert_linked(rows, links, parents)


def test_a_subtree_keeps_to_its_own_rows():
    mesh = make_soup(500, 4, grid=50, size=30)
    rows, links, parents = unfold_tree(build(mesh))
    top = int(links[ROOT, LINK])
    below = list_below(links, top)
    others = np.setdiff1d(np.arange(len(rows)), [top, *below])
    untouched = links[others].copy()
    assert reinsert_below(rows, links, parents, top, below) > 0
    assert (links[others] == untouched).all()
    assert sorted(list_below(links, top).tolist()) == sorted(below.tolist())
    fold_tree(mesh, rows, links)


@pytest.mark.parametrize("seed", [1, 7])
@pytest.mark.parametrize("traversal_cost", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("leaf_size", [1, 2, 4, 8])
def test_the_leaves_are_the_cheapest_of_all(leaf_size, traversal_cost, seed):
    mesh = make_soup(9, seed, grid=10, size=12)
    rows, links, _ = unfold_tree(build(mesh, leaf_size=1))
    best = sah_cost(fold_tree(mesh, rows, links, leaf_size, traversal_cost), traversal_cost=traversal_cost)

    # All ways to make leaves of some interior rows.
    interior = [row for row in list_all(links) if links[row, LINK] != 0]
    costs = []
    for chosen in itertools.product([False, True], repeat=len(interior)):
        is_leaf = links[:, LINK] == 0
        is_leaf[interior] = chosen
        nodes, prim_ids = np.zeros((len(rows), 8), np.float32), np.empty(mesh.face_count, np.int32)
        row_count = fold(rows, links, is_leaf, nodes, nodes.view(np.int32), prim_ids)
        bvh = Bvh(nodes[:row_count].view(NODE).reshape(-1), prim_ids, mesh)
        if bvh.nodes["count"].max() <= leaf_size:
            costs.append(sah_cost(bvh, traversal_cost=traversal_cost))
    assert best == pytest.approx(min(costs))

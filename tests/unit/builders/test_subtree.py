"""One range becomes a subtree: its nodes, its depth, and nothing outside its range."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.builders.invariants import WHOLE_TREE
from clbvh.builders.options import MAX_DEPTH
from clbvh.builders.sah.subtree import Rule, SubtreeTask, build_subtree, place_finished
from clbvh.bvh.bvh import measure_depth
from clbvh.structs import BOX_LANES, NODE

from ...soup import make_soup
from .prim_refs import make_prim_refs

UNTOUCHED = -99


def run(mesh, begin=0, end=None, *, buffer=0, depth=0, bins=16, leaf_size=4, traversal_cost=1.0):
    """Build the subtree of a range of a mesh; return its nodes in depth-first order, the prim_refs and the prim_ids."""
    count = mesh.face_count
    end = count if end is None else end
    prim_refs, _ = make_prim_refs(mesh)
    if buffer == 1:
        prim_refs = prim_refs[::-1].copy()
    rows = prim_refs[buffer, begin:end]
    centroids = rows[:, :3] - rows[:, 4:7]
    bounds = np.zeros((2, BOX_LANES), np.float32)
    bounds[0] = rows.min(axis=0)
    bounds[1, :3], bounds[1, 4:7] = centroids.min(axis=0), -centroids.max(axis=0)
    prim_ids = np.full(count, UNTOUCHED, np.int32)
    task = SubtreeTask(begin, end, buffer, depth, bounds)
    node_count = build_subtree(prim_refs, task, Rule(bins, leaf_size, traversal_cost), prim_ids)
    nodes = np.empty((node_count, BOX_LANES), np.float32)
    place_finished(prim_refs, end, node_count, WHOLE_TREE, nodes)
    return nodes.view(NODE).reshape(-1), prim_refs, prim_ids


@pytest.mark.parametrize("leaf_size", [1, 4])
@pytest.mark.parametrize(("begin", "end"), [(0, 1), (0, 100), (37, 38), (37, 39), (37, 90), (99, 100)])
def test_a_range_writes_to_its_own_slots_only(begin, end, leaf_size):
    mesh = make_soup(100, seed=1, copies=0.1)
    tree, prim_refs, prim_ids = run(mesh, begin, end, leaf_size=leaf_size)
    untouched, _ = make_prim_refs(mesh)

    assert 1 <= len(tree) <= 2 * (end - begin) - 1
    assert sorted(prim_ids[begin:end]) == list(range(begin, end))
    assert (prim_ids[:begin] == UNTOUCHED).all()
    assert (prim_ids[end:] == UNTOUCHED).all()
    for buffer in range(2):
        assert prim_refs[buffer, :begin].tobytes() == untouched[buffer, :begin].tobytes()
        assert prim_refs[buffer, end:].tobytes() == untouched[buffer, end:].tobytes()


def test_the_buffer_it_starts_from_does_not_matter():
    mesh = make_soup(300, seed=2)
    tree, _, prim_ids = run(mesh)
    other_tree, _, other_prim_ids = run(mesh, buffer=1)
    assert tree.tobytes() == other_tree.tobytes()
    assert prim_ids.tobytes() == other_prim_ids.tobytes()


def test_nodes_are_in_depth_first_order():
    tree, _, _ = run(make_soup(300, seed=3), 10, 250, leaf_size=1)
    expected_index = 1
    stack = [0]
    while stack:
        index = stack.pop()
        if tree["count"][index] == 0:
            assert tree["first"][index] == expected_index
            expected_index += 2
            stack += [tree["first"][index] + 1, tree["first"][index]]
    assert expected_index == len(tree)


def test_a_finished_node_finds_a_slot_of_a_finished_reference():
    """The worst case: every leaf has one primitive, and the tree is as deep as it may be on one side."""
    corners = np.float32(2.0) ** np.arange(-60, 60, 2)
    vertices = np.repeat(corners, 3)[:, None] * np.float32([[1, 0, 0], [0, 1, 0], [0, 0, 1]] * len(corners))
    for mirrored in (vertices, -vertices):
        mesh = Mesh.from_arrays(mirrored, np.arange(3 * len(corners)).reshape(-1, 3))
        tree, _, prim_ids = run(mesh, leaf_size=1)
        assert len(tree) == 2 * len(corners) - 1
        assert sorted(prim_ids) == list(range(len(corners)))
        assert sorted(tree["first"][tree["count"] == 1]) == list(range(len(corners)))


@pytest.mark.parametrize("prim_count", [1, 2, 3, 4, 5, 31, 32, 33, 1000])
@pytest.mark.parametrize("spare", [0, 1, 2])
def test_a_root_near_the_limit_still_fits_above_it(prim_count, spare):
    levels = math.ceil(math.log2(prim_count))
    depth = MAX_DEPTH - levels - spare
    tree, _, prim_ids = run(make_soup(prim_count, seed=4), depth=depth, leaf_size=1)
    assert len(tree) == 2 * prim_count - 1
    assert measure_depth(tree["first"], tree["count"]) <= levels + spare
    assert sorted(prim_ids) == list(range(prim_count))


def test_at_the_limit_halves_keep_the_order_of_the_primitives():
    tree, _, prim_ids = run(make_soup(64, seed=5), depth=MAX_DEPTH - 6, leaf_size=1)
    assert prim_ids.tolist() == list(range(64))
    assert len(tree) == 127
    assert measure_depth(tree["first"], tree["count"]) == 6


@pytest.mark.parametrize("leaf_size", [1, 2, 7, 255])
def test_a_dear_step_fills_the_leaves_and_a_cheap_one_empties_them(leaf_size):
    mesh = make_soup(500, seed=6)
    full, _, _ = run(mesh, leaf_size=leaf_size, traversal_cost=1e6)
    cheap, _, _ = run(mesh, leaf_size=leaf_size, traversal_cost=1e-6)
    full_counts = full["count"]
    assert full_counts.max() <= leaf_size
    # No split pays, so only ranges above the leaf size are split.
    assert full_counts.max() > leaf_size // 2
    assert len(full) <= len(cheap)
    assert (cheap["count"] == 1).sum() > 480


def test_a_leaf_is_taken_where_a_split_costs_as_much():
    # Two flat squares side by side, half area 1 each and 2 together: a leaf costs 2 * 2, a split traversal * 2 + 1 + 1.
    mesh = make_soup(2, seed=7)
    mesh.local_vertices[:] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]]
    assert len(run(mesh, leaf_size=2, traversal_cost=1.0)[0]) == 1
    assert len(run(mesh, leaf_size=2, traversal_cost=0.999)[0]) == 3
    assert len(run(mesh, leaf_size=1, traversal_cost=1.0)[0]) == 3


def test_triangles_without_extent_share_a_leaf():
    mesh = make_soup(4, seed=7, grid=0, size=0)
    assert len(run(mesh, leaf_size=4)[0]) == 1
    assert len(run(mesh, leaf_size=3)[0]) == 3

"""A finished tree: its depth, the checks of its invariants, each broken alone, and the boxes of moved vertices."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from clbvh import Mesh, MeshError, ValidationError, build, validate_tree
from clbvh.bvh.bvh import find_depths
from clbvh.structs import NODE

from ..hand_made import FACE_COUNT, make_leaf, make_tree


def test_a_tree_says_its_size_and_depth():
    bvh = make_tree()
    assert (bvh.node_count, bvh.depth, make_leaf().depth) == (5, 2, 0)
    nodes = np.zeros(9, NODE)
    nodes["first"], nodes["count"] = [1, 3, 7, 5, 0, 1, 2, 3, 4], [0, 0, 0, 0, 1, 1, 1, 1, 1]
    assert find_depths(nodes).tolist() == [0, 1, 1, 2, 2, 3, 3, 2, 2]
    # The deepest leaf counts and not the last.
    assert dataclasses.replace(bvh, nodes=nodes).depth == 3
    # Every left child is a leaf: as deep as a tree can be.
    levels = 100_000
    nodes = np.zeros(2 * levels + 1, NODE)
    nodes["first"][0:-1:2], nodes["count"][1::2], nodes["count"][-1] = np.arange(1, 2 * levels, 2), 1, 1
    assert find_depths(nodes)[-1] == levels


def refusal(bvh, **limits):
    """Return the message with which the tree is refused."""
    with pytest.raises(ValidationError) as caught:
        validate_tree(bvh, **limits)
    return str(caught.value)


def test_a_right_tree_passes_and_each_broken_link_array_and_limit_is_found():
    validate_tree(make_tree(), max_depth=2, max_leaf_size=2)
    validate_tree(make_leaf(), max_depth=0, max_leaf_size=FACE_COUNT)
    assert refusal(make_tree(), max_depth=1) == "node 3 lies 2 levels deep; the limit is 1"
    assert refusal(make_tree(), max_leaf_size=1) == "leaf 1 holds 2 primitives; the limit is 1"
    for node, field, value, message in [
        (3, "count", -1, "node 3 has a negative count"),
        (2, "first", 2, "interior node 2 does not have both its children"),
        (2, "first", 4, "interior node 2 does not have both its children behind it, inside"),
        (0, "first", 2**31 - 1, "interior node 0 "),
        (0, "first", 3, "node 1 is not reached exactly once"),
        (1, "first", -1, "leaf 1 lists primitives outside the mesh"),
        (4, "count", 2**31 - 1, "leaf 4 lists primitives outside the mesh"),
        (1, "count", 1, "prim_ids[1] lies in 0 leaves (none)"),
        (1, "count", 3, "prim_ids[2] lies in 2 leaves (1, 3)"),
    ]:
        bvh = make_tree()
        bvh.nodes[field][node] = value
        assert message in refusal(bvh)
    bvh = make_tree()
    nodes, prim_ids = bvh.nodes, bvh.prim_ids
    for change, message in [
        ({"prim_ids": np.int32([0, 2, 3, 2])}, "triangle 2 is listed 2 times instead of once, in leaves 1, 4"),
        ({"prim_ids": np.int32([0, 2, -1, 1])}, "leaf 3 lists triangle -1, which the mesh does not have"),
        ({"prim_ids": np.int32([0, 2, 3, 4])}, "leaf 4 lists triangle 4, which the mesh does not have"),
        ({"prim_ids": np.int32([0, 2, 1, 3])}, "the box of node 3 is not"),
        ({"prim_ids": prim_ids.astype(np.int64)}, "wrong dtypes"),
        ({"nodes": nodes.astype(NODE.descr[::-1])}, "wrong dtypes"),
        ({"nodes": nodes[:0]}, "4 triangles cannot have 0 nodes"),
        ({"nodes": np.concatenate([nodes, nodes[4:]])}, "node 5 is not reached exactly once"),
        ({"nodes": np.concatenate([nodes, nodes])}, "4 triangles cannot have 10 nodes"),
        ({"prim_ids": prim_ids[:3]}, "the tree lists 3 primitives; the mesh has 4 triangles"),
        ({"prim_ids": prim_ids.reshape(2, 2)}, "the tree lists 4 primitives; the mesh has 4 triangles"),
    ]:
        assert message in refusal(dataclasses.replace(bvh, **change))


def test_a_box_that_is_off_by_the_smallest_step_or_not_finite_is_found():
    parents = {0: 0, 1: 0, 2: 0, 3: 2, 4: 2}
    for node, axis, field, kind in itertools.product(range(5), range(3), ("aabb_min", "aabb_max"), range(5)):
        bvh = make_tree()
        box = bvh.nodes[field][node]
        steps = np.nextafter(box[axis], np.float32([-np.inf, np.inf]))
        box[axis] = [*steps, np.nan, np.inf, -np.inf][kind]
        # Its parent's box is checked against it, and may be named first.
        assert re.search(f"the box of node ({node}|{parents[node]}) is not exactly the union", refusal(bvh))


def test_the_hand_made_tree_follows_its_triangles():
    bvh = make_tree()
    before = bvh.nodes.tobytes()
    moved = bvh.refit(bvh.mesh.vertices * [1, 2, -1])
    # The box of all was (0, 0, 0) to (7, 1, 3). It is now centred, (-3.5, -1, -1.5) to (3.5, 1, 1.5), and scaled.
    assert (moved.mesh.origin.tolist(), moved.mesh.scale) == ([3.5, 1, -1.5], 0.25)
    shift = [3.5, 1, 1.5]
    assert (moved.nodes["aabb_min"] / 0.25 + shift).tolist() == [[0, 0, 0], [0, 0, 1], [2, 0, 0], [6, 0, 0], [2, 0, 2]]
    assert (moved.nodes["aabb_max"] / 0.25 + shift).tolist() == [[7, 2, 3], [5, 2, 3], [7, 2, 2], [7, 2, 0], [3, 2, 2]]
    assert (moved.nodes[["first", "count"]] == bvh.nodes[["first", "count"]]).all()
    assert bvh.nodes.tobytes() == before
    far = bvh.refit(moved.mesh.vertices + 2.0**20)
    assert far.nodes.tobytes() == moved.nodes.tobytes()
    for vertices, message in [
        (np.zeros((11, 3)), "11 vertices cannot replace the mesh's 12"),
        (np.zeros((12, 4)), r"shape \(V, 3\), not \(12, 4\)"),
        (np.full((12, 3), np.nan), "not finite"),
    ]:
        with pytest.raises(MeshError, match=message):
            bvh.refit(vertices)


def test_vertices_that_did_not_move_give_the_same_bytes_whatever_the_signs_of_zeros():
    """0.0 and -0.0 are equal, so which of them a box gets would be a matter of order."""
    zeros = np.random.default_rng(0).choice([-1.0, -0.0, 0.0, 1.0], (3000, 3))
    bvh = build(Mesh.from_arrays(zeros, np.arange(3000).reshape(-1, 3)))
    again = bvh.refit(bvh.mesh.vertices)
    assert again.nodes.tobytes() == bvh.nodes.tobytes()
    assert np.signbit(again.mesh.local_vertices[again.mesh.local_vertices == 0]).any()

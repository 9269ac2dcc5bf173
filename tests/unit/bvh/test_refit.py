"""A tree around vertices that have moved."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, build, validate_tree
from clbvh.errors import MeshError

from ...soup import make_soup
from ..hand_made import make_leaf, make_tree


def test_the_hand_made_tree_follows_its_triangles():
    bvh = make_tree()
    moved = bvh.refit(bvh.mesh.vertices * [1, 2, -1])
    # The box of all was (0, 0, 0) to (7, 1, 3). It is now centred, (-3.5, -1, -1.5) to (3.5, 1, 1.5), and scaled.
    assert moved.mesh.origin.tolist() == [3.5, 1, -1.5]
    assert moved.mesh.scale == 0.25
    shift = [3.5, 1, 1.5]
    assert (moved.nodes["aabb_min"] / 0.25 + shift).tolist() == [[0, 0, 0], [0, 0, 1], [2, 0, 0], [6, 0, 0], [2, 0, 2]]
    assert (moved.nodes["aabb_max"] / 0.25 + shift).tolist() == [[7, 2, 3], [5, 2, 3], [7, 2, 2], [7, 2, 0], [3, 2, 2]]
    for field in ("first", "count"):
        assert (moved.nodes[field] == bvh.nodes[field]).all()
    assert moved.prim_ids is bvh.prim_ids
    assert moved.mesh.faces is bvh.mesh.faces


def test_the_old_tree_stays_as_it_was():
    bvh = make_tree()
    before = bvh.nodes.tobytes(), bvh.mesh.vertices.tobytes()
    bvh.refit(bvh.mesh.vertices * 3)
    assert (bvh.nodes.tobytes(), bvh.mesh.vertices.tobytes()) == before


@pytest.mark.parametrize("seed", range(4))
def test_vertices_that_did_not_move_give_the_same_bytes(seed):
    bvh = build(make_soup(2000, seed, grid=3, size=2, copies=0.2, degenerate=0.2, scale=-0.5))
    again = bvh.refit(bvh.mesh.vertices)
    assert again.mesh.vertices.tobytes() == bvh.mesh.vertices.tobytes()
    assert again.nodes.tobytes() == bvh.nodes.tobytes()


def test_negative_zeros_leave_no_trace():
    """0.0 and -0.0 are equal, so which of them a box gets would be a matter of order."""
    choices = np.array([-1.0, -0.0, 0.0, 1.0], np.float32)
    vertices = np.random.default_rng(0).choice(choices, size=(3000, 3))
    bvh = build(Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3)))
    again = bvh.refit(vertices)
    assert np.signbit(again.mesh.local_vertices[again.mesh.local_vertices == 0]).any()
    assert again.nodes.tobytes() == bvh.nodes.tobytes()


def test_far_from_zero_the_boxes_keep_their_precision():
    bvh = build(make_soup(300, 1))
    there, far = (bvh.refit(bvh.mesh.vertices * 2**-10 + shift) for shift in (0.0, 2.0**24))
    assert far.nodes.tobytes() == there.nodes.tobytes()
    assert (far.mesh.origin == there.mesh.origin + 2.0**24).all()


@pytest.mark.parametrize("count", [1, 4])
def test_a_tree_that_is_one_leaf_can_move(count):
    bvh = make_leaf(count)
    moved = bvh.refit(bvh.mesh.vertices[:, ::-1])
    validate_tree(moved)


def test_all_vertices_may_meet_in_one_point():
    bvh = build(make_soup(500, 2))
    moved = bvh.refit(np.full_like(bvh.mesh.vertices, 7))
    validate_tree(moved)
    assert (moved.nodes["aabb_min"] == 0).all()
    assert (moved.nodes["aabb_max"] == 0).all()


def test_the_phases_are_timed():
    bvh = make_tree()
    assert set(bvh.refit(bvh.mesh.vertices).timings_ms) == {"localize", "refit"}


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (np.zeros((11, 3)), "11 vertices cannot replace the mesh's 12"),
        (np.zeros((12, 4)), r"shape \(V, 3\), not \(12, 4\)"),
        (np.full((12, 3), np.nan), "not finite"),
    ],
)
def test_vertices_that_do_not_fit_are_refused(vertices, message):
    with pytest.raises(MeshError, match=message):
        make_tree().refit(vertices)

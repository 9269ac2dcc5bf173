"""The checks of a tree: each invariant is broken alone, and the message names the node."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from clbvh import Bvh, build, validate_tree
from clbvh.errors import ValidationError
from clbvh.structs import NODE

from ...rays import mesh_as_on_device
from ...soup import make_soup
from ..hand_made import FACE_COUNT, make_leaf, make_tree


def refusal(bvh, **limits):
    """Return the message with which the tree is refused."""
    with pytest.raises(ValidationError) as caught:
        validate_tree(bvh, **limits)
    return str(caught.value)


def test_a_right_tree_passes():
    validate_tree(make_tree())
    validate_tree(make_tree(), max_depth=2, max_leaf_size=2)
    validate_tree(make_leaf(), max_depth=0, max_leaf_size=FACE_COUNT)
    validate_tree(make_leaf(1), max_depth=0, max_leaf_size=1)


def test_negative_zero_is_zero():
    bvh = make_tree()
    bvh.nodes["aabb_min"][0] = -0.0
    validate_tree(bvh)


# One value of one field of one node, and the message that names it.
BROKEN_NODES = {
    "negative count": (3, "count", -1, "node 3 has a negative count"),
    "child at itself": (2, "first", 2, "interior node 2 does not have both its children"),
    "child above its parent": (2, "first", 1, "interior node 2 does not have both its children behind it"),
    "negative child": (0, "first", -1, "interior node 0 does not have both its children"),
    "second child behind the end": (2, "first", 4, "interior node 2 does not have both its children behind it, inside"),
    "children far behind the end": (0, "first", 2**31 - 1, "interior node 0 "),
    "children that another node has": (0, "first", 3, "node 1 is not reached exactly once"),
    "children that overlap": (0, "first", 2, "node 1 is not reached exactly once"),
    "an interior node that became a leaf": (2, "count", 1, "node 3 is not reached exactly once"),
    "a leaf that became an interior node": (3, "count", 0, "interior node 3 "),
    "leaf before the list": (1, "first", -1, "leaf 1 lists primitives outside the mesh"),
    "leaf behind the list": (4, "first", 4, "leaf 4 lists primitives outside the mesh"),
    "leaf far behind the list": (4, "first", 2**31 - 1, "leaf 4 lists primitives outside the mesh"),
    "leaf over too many": (4, "count", 2, "leaf 4 lists primitives outside the mesh"),
    "huge leaf": (4, "count", 2**31 - 1, "leaf 4 lists primitives outside the mesh"),
    "leaf over too few": (1, "count", 1, r"prim_ids\[1\] lies in 0 leaves \(none\)"),
    "two leaves over one primitive": (1, "count", 3, r"prim_ids\[2\] lies in 2 leaves \(1, 3\)"),
    "leaf over another slot": (4, "first", 2, r"prim_ids\[2\] lies in 2 leaves \(3, 4\)"),
}


@pytest.mark.parametrize("case", BROKEN_NODES)
def test_a_broken_link_is_found(case):
    node, field, value, message = BROKEN_NODES[case]
    bvh = make_tree()
    bvh.nodes[field][node] = value
    assert re.search(message, refusal(bvh))


BROKEN_LISTS = {
    "a primitive twice": ([0, 2, 3, 2], "triangle 2 is listed 2 times instead of once, in leaves 1, 4"),
    "a primitive twice in one leaf": ([2, 2, 3, 1], "triangle 2 is listed 2 times instead of once, in leaves 1, 1"),
    "a primitive below zero": ([0, 2, -1, 1], "leaf 3 lists triangle -1, which the mesh does not have"),
    "a primitive behind the last": ([0, 2, 3, 4], "leaf 4 lists triangle 4, which the mesh does not have"),
}


@pytest.mark.parametrize("case", BROKEN_LISTS)
def test_a_broken_list_of_primitives_is_found(case):
    prim_ids, message = BROKEN_LISTS[case]
    bvh = make_tree()
    bvh.prim_ids[:] = prim_ids
    assert message in refusal(bvh)


def test_two_primitives_in_each_others_leaf_have_the_wrong_boxes():
    bvh = make_tree()
    bvh.prim_ids[:] = [0, 2, 1, 3]
    assert "the box of node 3 is not" in refusal(bvh)


@pytest.mark.parametrize("field", ["aabb_min", "aabb_max"])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("node", range(5))
def test_a_box_that_is_off_by_the_smallest_step_is_found(node, axis, field):
    for towards in (-np.inf, np.inf):
        bvh = make_tree()
        lane = bvh.nodes[field]
        lane[node, axis] = np.nextafter(lane[node, axis], np.float32(towards))
        # Its parent's box is checked against it, and may be named first.
        parent = {0: 0, 1: 0, 2: 0, 3: 2, 4: 2}[node]
        assert re.search(f"the box of node ({node}|{parent}) is not exactly the union", refusal(bvh))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("node", range(5))
def test_a_box_that_is_not_finite_is_found(node, value):
    for field in ("aabb_min", "aabb_max"):
        bvh = make_tree()
        bvh.nodes[field][node, 1] = value
        assert "the box of node" in refusal(bvh)


def test_a_box_that_is_wrong_all_the_way_up_is_found_at_the_leaf():
    bvh = make_tree()
    bvh.nodes["aabb_max"][[0, 2, 4], 1] = 5
    assert "the box of node 4 is not" in refusal(bvh)


def test_a_vertex_that_moved_after_the_build_is_found():
    bvh = make_tree()
    bvh.mesh.local_vertices[3, 0] -= 1
    assert "the box of node 4 is not" in refusal(bvh)


def test_wrong_types_are_found():
    bvh = make_tree()
    assert "wrong dtypes" in refusal(dataclasses.replace(bvh, prim_ids=bvh.prim_ids.astype(np.int64)))
    assert "wrong dtypes" in refusal(dataclasses.replace(bvh, nodes=bvh.nodes.astype(NODE.descr[::-1])))


def test_a_node_with_two_parents_is_found():
    # Four nodes where five are needed: 0 has children 1 and 2, 1 has 2 and 3.
    mesh = make_leaf(3).mesh
    nodes = np.array(
        [
            ([0, 0, 0], 1, [5, 1, 2], 0),
            ([0, 0, 0], 2, [5, 1, 2], 0),
            ([0, 0, 0], 0, [3, 1, 1], 2),
            ([4, 0, 2], 2, [5, 1, 2], 1),
        ],
        NODE,
    )
    assert refusal(Bvh(nodes, np.arange(3, dtype=np.int32), mesh)) == "node 2 is not reached exactly once"


def test_too_few_and_too_many_rows_are_found():
    bvh = make_tree()
    assert "4 triangles cannot have 0 nodes" in refusal(dataclasses.replace(bvh, nodes=bvh.nodes[:0]))
    spare = np.concatenate([bvh.nodes, bvh.nodes[4:]])
    assert "node 5 is not reached exactly once" in refusal(dataclasses.replace(bvh, nodes=spare))
    crowd = np.concatenate([bvh.nodes, bvh.nodes])
    assert "4 triangles cannot have 10 nodes" in refusal(dataclasses.replace(bvh, nodes=crowd))


def test_a_list_of_another_length_is_found():
    bvh = make_tree()
    for prim_ids in (bvh.prim_ids[:3], np.append(bvh.prim_ids, np.int32(0)), bvh.prim_ids.reshape(2, 2)):
        message = refusal(dataclasses.replace(bvh, prim_ids=prim_ids))
        assert message == f"the tree lists {prim_ids.size} primitives; the mesh has 4 triangles"


def test_another_mesh_is_found():
    bvh = make_tree()
    other = mesh_as_on_device(bvh.mesh.local_vertices[::-1], bvh.mesh.faces)
    assert "the box of node 1 is not" in refusal(dataclasses.replace(bvh, shape=other))


def test_the_limits_are_kept_or_the_node_is_named():
    assert refusal(make_tree(), max_depth=1) == "node 3 lies 2 levels deep; the limit is 1"
    assert refusal(make_tree(), max_depth=0) == "node 1 lies 1 levels deep; the limit is 0"
    assert refusal(make_tree(), max_leaf_size=1) == "leaf 1 holds 2 primitives; the limit is 1"


def swap(array, one, other):
    array[[one, other]] = array[[other, one]]


def nudge_box(bvh, node, random):
    lane = bvh.nodes[["aabb_min", "aabb_max"][random.integers(2)]]
    axis = random.integers(3)
    lane[node, axis] = np.nextafter(lane[node, axis], np.float32(random.choice([-np.inf, np.inf])))


def nudge_link(bvh, node, random):
    bvh.nodes["first"][node] += random.choice([-1, 1])


def nudge_count(bvh, node, random):
    bvh.nodes["count"][node] += random.choice([-1, 1])


def repeat_primitive(bvh, node, random):
    bvh.prim_ids[node % len(bvh.prim_ids)] = bvh.prim_ids[(node + 1) % len(bvh.prim_ids)]


@pytest.mark.parametrize("damage", [nudge_box, nudge_link, nudge_count, repeat_primitive])
@pytest.mark.parametrize("seed", range(20))
def test_small_damage_to_a_built_tree_is_found(damage, seed):
    random = np.random.default_rng(seed)
    bvh = build(make_soup(200, seed, copies=0.1, degenerate=0.1))
    validate_tree(bvh)
    damage(bvh, random.integers(bvh.node_count), random)
    assert re.search(r"node|leaf|leaves", refusal(bvh))

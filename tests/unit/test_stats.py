"""The SAH cost, against numbers worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import Mesh, build, sah_cost

from .hand_made import make_leaf, make_tree

# Half areas of the hand-made tree's boxes, from their sizes: xy + yz + zx.
ROOT = 7 * 1 + 1 * 3 + 3 * 7
NODE_1 = 5 * 1 + 1 * 2 + 2 * 5
NODE_2 = 5 * 1 + 1 * 2 + 2 * 5
FLAT = 1 * 1


def test_cost_of_the_hand_made_tree():
    expected = (ROOT + NODE_2 + 2 * NODE_1 + FLAT + FLAT) / ROOT
    assert sah_cost(make_tree()) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(("traversal", "intersection"), [(3.0, 1.0), (1.0, 3.0), (0.0, 2.0), (8.0, 0.0)])
def test_both_costs_have_their_weight(traversal, intersection):
    inner = traversal * (ROOT + NODE_2)
    leaves = intersection * (2 * NODE_1 + FLAT + FLAT)
    cost = sah_cost(make_tree(), traversal_cost=traversal, intersection_cost=intersection)
    assert cost == pytest.approx((inner + leaves) / ROOT, rel=1e-15)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_leaf_costs_its_triangles(count):
    assert sah_cost(make_leaf(count)) == count
    assert sah_cost(make_leaf(count), intersection_cost=2.5) == 2.5 * count


def test_a_mesh_without_extent_costs_everything():
    bvh = build(Mesh.from_arrays(np.ones((3, 3)), np.tile([0, 1, 2], (8, 1))), leaf_size=2)
    leaves = (bvh.nodes["count"] > 0).sum()
    assert sah_cost(bvh) == 8 + (leaves - 1)


@pytest.mark.parametrize("scale", [1e-30, 1e-15, 1e15, 1e30])
def test_the_unit_of_length_does_not_matter(scale):
    bvh = make_tree()
    nodes = bvh.nodes.copy()
    for field in ("aabb_min", "aabb_max"):
        nodes[field] *= np.float32(scale)
    assert sah_cost(dataclasses.replace(bvh, nodes=nodes)) == pytest.approx(sah_cost(bvh), rel=1e-6)

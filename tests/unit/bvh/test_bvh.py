"""A finished tree and the walk that measures it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import Bvh, Mesh
from clbvh.bvh.bvh import measure_depth
from clbvh.structs import NODE

from ..hand_made import make_leaf, make_tree


def make_chain(levels):
    """Return nodes in which every left child is a leaf: as deep as a tree can be."""
    nodes = np.zeros(2 * levels + 1, NODE)
    nodes["count"] = 1
    nodes["count"][0 : 2 * levels : 2] = 0
    nodes["first"][0 : 2 * levels : 2] = np.arange(1, 2 * levels, 2)
    return nodes


def test_a_tree_says_its_size_and_depth():
    bvh = make_tree()
    assert (bvh.node_count, bvh.depth) == (5, 2)
    assert repr(bvh) == "Bvh('four triangles', nodes=5, depth=2)"


def test_a_leaf_has_depth_zero():
    assert (make_leaf().node_count, make_leaf().depth) == (1, 0)


@pytest.mark.parametrize("levels", [1, 2, 63, 64, 100_000])
def test_depth_of_a_chain_is_its_length(levels):
    nodes = make_chain(levels)
    assert measure_depth(nodes["first"], nodes["count"]) == levels


def test_the_deepest_leaf_counts_and_not_the_last():
    first = np.array([1, 3, 7, 5, 0, 1, 2, 3, 4], np.int32)
    count = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1], np.int32)
    assert measure_depth(first, count) == 3  # nodes 5 and 6; nodes 7 and 8 have depth 2


def test_a_tree_cannot_be_changed_and_compares_by_identity():
    bvh = make_tree()
    with pytest.raises(dataclasses.FrozenInstanceError):
        bvh.nodes = None
    assert bvh != make_tree()
    assert bvh == bvh


def test_timings_are_optional():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    assert Bvh(np.zeros(1, NODE), np.zeros(1, np.int32), mesh).timings_ms == {}

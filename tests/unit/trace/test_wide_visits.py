"""Counts in wide trees: the same hits as in the binary tree, and counts that can be told by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import build, make_shape
from clbvh.support.host_threads import HostThreads
from clbvh.trace.check.visits import HostTraversal, count_visits, count_wide_visits

from ...rays import centred, hard_rays
from ..hand_made import make_leaf

DOWN, ABOVE = [0, 0, -1], 10


@pytest.fixture(scope="module")
def bvh():
    return build(centred(make_shape("knot", triangles=1800)))


@pytest.fixture(scope="module")
def rays(bvh):
    return hard_rays(bvh.mesh, 1024, np.random.default_rng(3))


@pytest.mark.parametrize("width", [4, 8])
def test_hits_are_those_of_the_binary_tree(bvh, rays, width):
    wide, binary = count_wide_visits(bvh, width, *rays), count_visits(bvh, *rays)
    assert np.array_equal(wide.prim_id, binary.prim_id)
    assert (wide.prim_id >= 0).any()
    # Fewer and larger steps.
    assert wide.node_steps_per_ray < binary.node_steps_per_ray


@pytest.mark.parametrize("width", [4, 8])
def test_a_tree_of_one_block(width):
    leaf = make_leaf()
    visits = count_wide_visits(leaf, width, [[0.25, 0.25, ABOVE], [-5, 0.25, ABOVE]], [DOWN, DOWN])
    assert visits.node_steps.tolist() == [1, 1]
    assert visits.leaf_visits.tolist() == [1, 0]
    assert visits.triangle_tests.tolist() == [4, 0]
    assert visits.prim_id.tolist() == [0, -1]


def test_leaf_visits_are_blocks_and_tests_the_triangles_in_them(bvh, rays):
    visits = count_wide_visits(bvh, 8, *rays)
    assert (visits.triangle_tests >= visits.leaf_visits).all()
    assert (visits.triangle_tests <= 8 * visits.leaf_visits).all()


def test_no_rays(bvh):
    visits = count_wide_visits(bvh, 4, np.empty((0, 3)), np.empty((0, 3)))
    assert visits.node_steps_per_ray == 0


def test_threads_count_the_same(bvh):
    generator = np.random.default_rng(4)
    rays = hard_rays(bvh.mesh, 40_000, generator)
    traversal = HostTraversal(bvh)
    alone = traversal.count_visits(*rays)
    with HostThreads(3) as threads:
        shared = traversal.count_visits(*rays, threads=threads)
    for name in ("node_steps", "leaf_visits", "triangle_tests", "prim_id"):
        assert np.array_equal(getattr(alone, name), getattr(shared, name))

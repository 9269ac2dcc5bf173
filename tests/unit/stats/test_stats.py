"""What a tree consists of and how good it is, against numbers worked out by hand."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from clbvh import Mesh, build, measure_tree, sah_cost
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.stats.overlap import measure_overlap
from clbvh.structs import LAYOUT_WIDTHS

from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

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


def test_stats_of_the_hand_made_tree():
    stats = measure_tree(make_tree())
    assert (stats.triangle_count, stats.node_count, stats.interior_count, stats.leaf_count) == (4, 5, 2, 3)
    assert (stats.depth, stats.mean_leaf_depth, stats.mean_leaf_size) == (2, 5 / 3, 4 / 3)
    assert stats.leaf_sizes == (0, 2, 1)
    assert stats.leaf_depths == (0, 1, 2)
    assert stats.sah_cost == sah_cost(make_tree())
    assert (stats.epo, stats.epo_triangles) == (measure_overlap(make_tree()).epo, 4)
    assert stats.host_bytes == 5 * 32 + 4 * 4
    assert stats.host_bytes_per_triangle == 44
    # Four triangles are one block.
    assert stats.device_bytes == {"bvh2": 2 * 64 + 4 * 40, "bvh4": 112 + 160, "bvh8": 224 + 320}
    assert stats.device_bytes_per_triangle == {"bvh2": 72, "bvh4": 68, "bvh8": 136}


@pytest.mark.parametrize("count", [1, 4])
def test_stats_of_a_leaf(count):
    stats = measure_tree(make_leaf(count))
    assert (stats.node_count, stats.interior_count, stats.leaf_count, stats.depth) == (1, 0, 1, 0)
    assert (stats.mean_leaf_depth, stats.mean_leaf_size, stats.epo) == (0, count, 0)
    assert stats.leaf_sizes == (0,) * count + (1,)
    assert stats.leaf_depths == (1,)
    assert stats.device_bytes == {"bvh2": 64 + 40 * count, "bvh4": 112 + 160, "bvh8": 224 + 320}


@pytest.mark.parametrize("seed", range(3))
def test_what_is_reported_for_the_device_is_what_it_gets(seed):
    bvh = build(make_soup(500, seed))
    measured = measure_tree(bvh).device_bytes
    assert measured.keys() == LAYOUT_WIDTHS.keys()
    for layout, size in measured.items():
        arrays = make_device_arrays(bvh, layout)
        assert size == arrays.nodes.nbytes + arrays.blocks.nbytes


def test_costs_reach_both_measures():
    stats = measure_tree(make_tree(), traversal_cost=3, intersection_cost=0.5)
    assert (stats.traversal_cost, stats.intersection_cost) == (3, 0.5)
    assert stats.sah_cost == sah_cost(make_tree(), traversal_cost=3, intersection_cost=0.5)
    assert stats.epo == measure_overlap(make_tree(), traversal_cost=3, intersection_cost=0.5).epo != 0


def test_the_overlap_of_a_large_tree_is_sampled_unless_all_is_wanted():
    bvh = build(make_soup(1000, 1))
    assert measure_tree(bvh).epo_triangles == 1000
    assert measure_tree(bvh, overlap_sample=100).epo_triangles == 100
    assert measure_tree(bvh, overlap_sample=None).epo == measure_overlap(bvh).epo


def test_histograms_count_every_leaf_once():
    bvh = build(make_soup(3000, 2, copies=0.3), leaf_size=8)
    stats = measure_tree(bvh)
    sizes, depths = np.array(stats.leaf_sizes), np.array(stats.leaf_depths)
    assert sizes.sum() == depths.sum() == stats.leaf_count
    assert (sizes * np.arange(len(sizes))).sum() == 3000
    assert len(depths) == stats.depth + 1
    assert (depths * np.arange(len(depths))).sum() / stats.leaf_count == pytest.approx(stats.mean_leaf_depth)
    # A binary tree without gaps: the leaves fill the unit interval (Kraft, 1949).
    assert (depths * 0.5 ** np.arange(len(depths))).sum() == 1


def test_stats_become_json_and_back():
    stats = measure_tree(make_tree())
    read = json.loads(json.dumps(stats.as_dict()))
    assert read["leaf_sizes"] == [0, 2, 1]
    assert read["device_bytes_per_triangle"] == {"bvh2": 72, "bvh4": 68, "bvh8": 136}
    assert read.keys() == {field.name for field in dataclasses.fields(stats)} | {
        "host_bytes_per_triangle",
        "device_bytes_per_triangle",
    }

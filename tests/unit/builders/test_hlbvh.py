"""The steps of the fast build: codes, treelets, order, clusters, and cuts along the curve."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import build
from clbvh.builders.hlbvh.clusters import (
    CLUSTER_SIZE,
    Cluster,
    cut_clusters,
    make_sweep_scratch,
    sweep_cluster,
)
from clbvh.builders.hlbvh.treelets import bound_points, count_cells, cut_treelets, make_grid
from clbvh.builders.options import MAX_DEPTH
from clbvh.builders.prim_refs import PrimSlice
from clbvh.builders.sah.subtree import Rule
from clbvh.bvh.bvh import measure_depth
from clbvh.structs import BOX_LANES, NODE

from ...soup import make_soup
from .reference import cost_of, make_prim_refs


def find_cells(mesh, axis_bits):
    bounds = np.empty((2, BOX_LANES), np.float32)
    bound_points(mesh.local_vertices, 0, len(mesh.local_vertices), bounds)
    cells, counts = np.empty(mesh.face_count, np.uint16), np.zeros(1 << 15, np.int32)
    whole = PrimSlice(mesh.local_vertices, mesh.faces, 0, mesh.face_count)
    count_cells(whole, make_grid(bounds, 1, axis_bits), cells, counts)
    return cells, counts


def interleave(place, bits):
    return sum((place[axis] >> bit & 1) << 3 * bit + 2 - axis for axis in range(3) for bit in range(bits))


@pytest.mark.parametrize("axis_bits", [1, 3, 5])
def test_the_code_of_a_cell_alternates_the_bits_of_its_coordinates(axis_bits):
    mesh = make_soup(500, seed=1, size=3)
    cells, counts = find_cells(mesh, axis_bits)
    corners = mesh.local_vertices[mesh.faces].astype(float)
    lower, extent = mesh.local_vertices.min(axis=0), np.ptp(mesh.local_vertices, axis=0).max()
    places = ((corners.min(axis=1) + corners.max(axis=1)) / 2 - lower) / extent * (1 << axis_bits) * 0.99999
    # A centroid next to a wall may fall on either side of it, by rounding.
    sure = (np.abs(places - np.round(places)) > 1e-4).all(axis=1)
    assert sure.mean() > 0.9
    expected = np.array([interleave(place, axis_bits) for place in places.astype(int).tolist()])
    assert (cells[sure] == expected[sure]).all()
    assert counts.tolist() == np.bincount(cells, minlength=len(counts)).tolist()


def cut_by_halves(counts, begin, size, limit):
    """Return (first cell, cells) of the blocks, from the whole grid down."""
    total = int(counts[begin : begin + size].sum())
    if total == 0:
        return []
    if total <= limit or size == 1:
        return [(begin, size)]
    half = size // 2
    return cut_by_halves(counts, begin, half, limit) + cut_by_halves(counts, begin + half, half, limit)


@pytest.mark.parametrize("limit", [1, 10, 100, 10**6])
def test_treelets_are_the_largest_blocks_within_the_limit(limit):
    for seed in range(3):
        random = np.random.default_rng(seed)
        counts = (random.integers(0, 30, 512) * (random.random(512) < 0.3)).astype(np.int32)
        treelet_of_cell, first_cells = np.full(512, -1, np.int32), np.empty(512, np.int64)
        count = cut_treelets(counts, limit, treelet_of_cell, first_cells)
        blocks = cut_by_halves(counts, 0, 512, limit)
        assert first_cells[:count].tolist() == [begin for begin, _ in blocks]
        for treelet, (begin, size) in enumerate(blocks):
            assert (treelet_of_cell[begin : begin + size] == treelet).all()


def expected_cuts(codes, begin, end):
    """Where clusters begin, by the definition: at the highest bit that differs, in the middle if none does."""
    if end - begin <= CLUSTER_SIZE:
        return [begin]
    differing = int(codes[begin] ^ codes[end - 1])
    cut = (begin + end) // 2
    if differing:
        has_bit = codes[begin:end] & 1 << differing.bit_length() - 1 != 0
        cut = begin + int(has_bit.argmax())
    return expected_cuts(codes, begin, cut) + expected_cuts(codes, cut, end)


def test_clusters_are_short_and_cut_where_high_bits_change():
    for codes in (
        [0], [5] * 32, [5] * 33, [5] * 1000, range(1000), [0] * 40 + [7] * 40 + [2**26] * 3, [0] * 20 + [4] * 25,
        [3] * 10 + [4] * 30 + [6] * 30, np.random.default_rng(5).integers(0, 200, 700),
    ):  # fmt: skip
        codes = np.sort(np.array(codes, np.int32))
        begins = np.empty(len(codes) + 1, np.int32)
        count = cut_clusters(codes, len(codes), begins)
        assert begins[: count + 1].tolist() == [*expected_cuts(codes, 0, len(codes)), len(codes)]


def sweep(count, depth, leaf_size):
    """Return the references of a cluster, and the nodes and prim_ids of its part of the tree."""
    rows = make_prim_refs(make_soup(count, seed=count, size=300))[0][0]
    nodes, prim_ids = np.zeros((2 * count, BOX_LANES), np.float32), np.empty(count, np.int32)
    cluster, rule = Cluster(0, count, depth, 0, 1, 0), Rule(16, leaf_size, 1.0)
    end = sweep_cluster(rows, cluster, rule, nodes, prim_ids, make_sweep_scratch.py_func())
    return rows, nodes[:end].view(NODE).reshape(-1), prim_ids


def plain_leaves(rows, begin, end, leaf_size):
    """Return the leaves that the cheapest cuts along the order give, as ranges."""
    costs = [cost_of(rows[begin:cut]) + cost_of(rows[cut:end]) for cut in range(begin + 1, end)]
    best, whole = min(costs, default=np.inf), cost_of(rows[begin:end])
    if end - begin <= leaf_size and not whole / (end - begin) + best < whole:
        return [(begin, end)]
    cut = begin + 1 + costs.index(best)
    return plain_leaves(rows, begin, cut, leaf_size) + plain_leaves(rows, cut, end, leaf_size)


@pytest.mark.parametrize("leaf_size", [1, 4, 32])
def test_a_cluster_is_cut_where_it_is_cheapest(leaf_size):
    for count in (1, 2, 3, 17, CLUSTER_SIZE):
        rows, nodes, prim_ids = sweep(count, 0, leaf_size)
        leaves = nodes[nodes["count"] > 0]
        ranges = sorted(zip(leaves["first"], leaves["first"] + leaves["count"], strict=True))
        assert ranges == plain_leaves(rows, 0, count, leaf_size)
        assert prim_ids.tolist() == list(range(count))


def test_at_the_depth_limit_a_cluster_is_halved():
    _, nodes, _ = sweep(CLUSTER_SIZE, MAX_DEPTH - 5, 1)
    assert len(nodes) == 2 * CLUSTER_SIZE - 1
    assert measure_depth(nodes["first"], nodes["count"]) == 5


def test_the_primitives_below_every_node_are_one_range():
    nodes = build(make_soup(3000, seed=6), quality="fast").nodes
    begin, end = nodes["first"].copy(), nodes["first"] + nodes["count"]
    for row in np.flatnonzero(nodes["count"] == 0)[::-1]:
        left = nodes["first"][row]
        assert end[left] == begin[left + 1]
        begin[row], end[row] = begin[left], end[left + 1]
    assert (begin[0], end[0]) == (0, 3000)

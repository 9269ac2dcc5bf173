"""The end-point overlap, against areas worked out by hand and a slow reference that clips everything to everything."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import ConfigError, Mesh, build
from clbvh.stats.overlap import measure_overlap

from ...soup import make_soup
from ..hand_made import make_leaf


def area_of(polygon):
    edges = polygon[1:] - polygon[0]
    return np.linalg.norm(np.cross(edges[:-1], edges[1:]).sum(axis=0)) / 2


def slow_area(triangle, lower, upper):
    """Return the area of a triangle inside a box: cut by one plane after the other, corner by corner."""
    polygon = [np.array(corner, np.float64) for corner in triangle]
    for axis in range(3):
        for sign, plane in ((1, float(upper[axis])), (-1, -float(lower[axis]))):
            kept = []
            for here, there in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                a, b = sign * here[axis] - plane, sign * there[axis] - plane
                if a <= 0:
                    kept.append(here)
                if a * b < 0:
                    kept.append(here + (there - here) * (a / (a - b)))
            polygon = kept
    return area_of(np.array(polygon)) if len(polygon) > 2 else 0.0


def slow_epo(bvh, traversal_cost, intersection_cost):
    """Sum up over all nodes and all triangles that are not below them."""
    corners = bvh.mesh.local_vertices[bvh.mesh.faces].astype(np.float64)
    below, total = [set() for _ in bvh.nodes], 0.0
    for node in reversed(range(bvh.node_count)):
        first, count = int(bvh.nodes["first"][node]), int(bvh.nodes["count"][node])
        below[node] = set(bvh.prim_ids[first : first + count].tolist()) if count else below[first] | below[first + 1]
        cost = count * intersection_cost or traversal_cost
        for prim in set(range(len(corners))) - below[node]:
            total += cost * slow_area(corners[prim], bvh.nodes["aabb_min"][node], bvh.nodes["aabb_max"][node])
    return total / sum(map(area_of, corners))


def test_it_is_what_the_slow_reference_says():
    for leaf_size, soup in (
        (1, {"grid": 30}),
        (4, {"grid": 4, "size": 3}),  # many coplanar
        (8, {"grid": 30, "size": 5, "degenerate": 0.4, "copies": 0.4}),
        (2, {"grid": 30, "size": 30, "scale": 1e30}),
    ):
        bvh = build(make_soup(50, seed=leaf_size, **soup), leaf_size=leaf_size)
        expected = slow_epo(bvh, 1.2, 0.7)
        assert expected > 0
        assert measure_overlap(bvh, traversal_cost=1.2, intersection_cost=0.7).epo == pytest.approx(expected, rel=1e-9)


def test_boxes_that_only_touch_or_have_no_area_have_no_overlap():
    pair = Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]], [[0, 1, 2], [0, 1, 3]])
    point = Mesh.from_arrays(np.ones((3, 3)), np.tile([0, 1, 2], (8, 1)))
    for mesh in (pair, point):
        assert measure_overlap(build(mesh, leaf_size=1)).epo == 0
    assert measure_overlap(make_leaf(1)).epo == measure_overlap(make_leaf(4)).epo == 0


def test_a_sample_is_counted_and_near():
    bvh = build(make_soup(5000, 1, grid=300, size=30))
    whole, sample = measure_overlap(bvh), measure_overlap(bvh, sample=1000)
    assert (whole.triangle_count, sample.triangle_count) == (5000, 1000)
    assert sample.epo != whole.epo == pytest.approx(sample.epo, rel=0.05)
    assert measure_overlap(bvh, sample=5000) == measure_overlap(bvh, sample=10**9) == whole
    with pytest.raises(ConfigError, match="at least 1 triangle, not 0"):
        measure_overlap(bvh, sample=0)

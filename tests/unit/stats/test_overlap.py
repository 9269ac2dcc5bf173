"""The end-point overlap, against areas worked out by hand and a slow reference that clips everything to everything."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Bvh, Mesh, build, validate_tree
from clbvh.errors import ConfigError
from clbvh.stats.overlap import measure_overlap
from clbvh.structs import NODE

from ...rays import mesh_as_on_device
from ...soup import make_soup
from ..hand_made import make_leaf, make_tree


def make_pair(left, right):
    """Return a tree of a root and two leaves, each over one triangle of three (x, y, z) corners."""
    corners = np.array([left, right], np.float32)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    nodes = np.array(
        [
            (lower.min(axis=0), 1, upper.max(axis=0), 0),
            (lower[0], 0, upper[0], 1),
            (lower[1], 1, upper[1], 1),
        ],
        NODE,
    )
    mesh = mesh_as_on_device(corners.reshape(-1, 3), np.arange(6).reshape(2, 3))
    return Bvh(nodes, np.arange(2, dtype=np.int32), mesh)


# A right triangle over half of the square from (0, 0) to (4, 4).
LARGE = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
LARGE_AREA = 8.0


def shift(triangle, *offset):
    return (np.array(triangle) + offset).tolist()


def test_boxes_that_do_not_meet_have_no_overlap():
    assert measure_overlap(make_pair(LARGE, shift(LARGE, 5, 0, 0))).epo == 0
    assert measure_overlap(make_pair(LARGE, shift(LARGE, 0, 0, 1))).epo == 0


def test_boxes_that_share_an_edge_have_no_overlap():
    assert measure_overlap(make_pair(LARGE, shift(LARGE, 4, 0, 0))).epo == 0


def test_the_hand_made_tree_has_an_overlap_that_can_be_seen():
    """Node 1 is the box (0, 0, 0) to (5, 1, 2) and holds face 1; node 2 from (2, 0, 1) holds face 2, of node 1.

    Face 2 is in no child of node 2, and face 1 in no child of node 1. All four faces have the same area.
    """
    node_1_by_face_1, node_2_by_face_2 = 2, 1
    assert measure_overlap(make_tree()).epo == pytest.approx((node_1_by_face_1 + node_2_by_face_2) / 4, rel=1e-15)


def test_a_small_triangle_in_a_large_box_costs_its_share():
    """The small one's corner (3, 3) is outside the large one, but inside its box."""
    small = [[3, 3, 0], [4, 3, 0], [3, 4, 0]]
    # The large triangle reaches x + y = 4, and so only touches the small one's box from (3, 3).
    assert measure_overlap(make_pair(LARGE, small)).epo == pytest.approx(0.5 / (LARGE_AREA + 0.5), rel=1e-15)


def test_a_triangle_is_clipped_to_the_box():
    """The same shape one to the right: 3 x 4 of the square overlap."""
    left_in_right = 3 * 3 / 2  # from x = 1 on, half of a square of 3
    right_in_left = LARGE_AREA - 0.5  # all but the corner beyond x = 4
    epo = measure_overlap(make_pair(LARGE, shift(LARGE, 1, 0, 0))).epo
    assert epo == pytest.approx((left_in_right + right_in_left) / (2 * LARGE_AREA), rel=1e-15)


def test_a_triangle_that_is_cut_by_all_planes_keeps_nine_corners():
    """The plane x + y + z = 0 meets the cube in a regular hexagon; the triangle cuts off every second corner of it."""
    reach = 1.875
    large = -reach * np.array([[1, -1, 0], [0, 1, -1], [-1, 0, 1]])
    cube = np.array([[-1, -1, -1], [1, 1, 1], [1, 1, -1]])
    hexagon = 3 * np.sqrt(3)  # with sides of sqrt(2)
    corner = np.sqrt(3) * (2 - reach) ** 2 / 2  # its height is (2 - reach) / sqrt(2), its angle 120 degrees
    inside = hexagon - 3 * corner + area_of(cube)  # the box of `large` holds all of the other triangle
    epo = measure_overlap(make_pair(large, cube)).epo
    assert epo == pytest.approx(inside / (area_of(large) + area_of(cube)), rel=1e-14)


def test_a_triangle_in_the_face_of_a_box_lies_inside():
    """As a ray that ends there does: it must visit the box."""
    standing = [[0, 0, 0], [4, 0, 0], [0, 0, 4]]
    epo = measure_overlap(make_pair(LARGE, standing)).epo
    assert epo == 0  # the boxes are flat, and meet in a line
    solid = [[0, 0, 0], [4, 4, 0], [0, 4, 4]]
    epo = measure_overlap(make_pair(LARGE, solid)).epo
    # Of the large one, all lies in the face z = 0 of the other's box; of the other, only an edge touches z = 0.
    assert epo == pytest.approx(LARGE_AREA / (LARGE_AREA + area_of(np.array(solid, float))), rel=1e-15)


@pytest.mark.parametrize(("traversal", "intersection"), [(1.2, 1.0), (0.0, 1.0), (1.0, 0.0), (2.0, 3.0)])
def test_costs_are_weights(traversal, intersection):
    node_1_by_face_1 = 2 * intersection
    node_2_by_face_2 = traversal
    epo = measure_overlap(make_tree(), traversal_cost=traversal, intersection_cost=intersection).epo
    assert epo == pytest.approx((node_1_by_face_1 + node_2_by_face_2) / 4, rel=1e-15)


@pytest.mark.parametrize("count", [1, 4])
def test_a_tree_that_is_one_leaf_has_no_overlap(count):
    assert measure_overlap(make_leaf(count)).epo == 0


def test_a_surface_without_area_has_no_overlap():
    bvh = build(Mesh.from_arrays(np.ones((3, 3)), np.tile([0, 1, 2], (8, 1))), leaf_size=2)
    assert measure_overlap(bvh).epo == 0


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
    below = [set() for _ in bvh.nodes]
    for node in reversed(range(bvh.node_count)):
        first, count = int(bvh.nodes["first"][node]), int(bvh.nodes["count"][node])
        below[node] = set(bvh.prim_ids[first : first + count].tolist()) if count else below[first] | below[first + 1]
    total = 0.0
    for node, own in zip(bvh.nodes, below, strict=True):
        cost = node["count"] * intersection_cost if node["count"] else traversal_cost
        for prim in set(range(len(corners))) - own:
            total += cost * slow_area(corners[prim], node["aabb_min"], node["aabb_max"])
    return total / sum(map(area_of, corners))


@pytest.mark.parametrize(
    ("soup", "leaf_size"),
    [
        pytest.param({"count": 60, "seed": 1, "grid": 30, "size": 20}, 4, id="seed 1"),
        pytest.param({"count": 60, "seed": 2, "grid": 30, "size": 20}, 1, id="seed 2, leaves of one"),
        pytest.param({"count": 60, "seed": 3, "grid": 4, "size": 3}, 4, id="seed 3, many coplanar"),
        pytest.param({"count": 60, "seed": 4, "grid": 30, "size": 5, "degenerate": 0.4}, 8, id="seed 4, degenerate"),
        pytest.param({"count": 60, "seed": 5, "grid": 30, "size": 5, "copies": 0.6}, 2, id="seed 5, copies"),
        pytest.param({"count": 40, "seed": 6, "grid": 30, "size": 30, "scale": 1e-30}, 2, id="seed 6, tiny"),
        pytest.param({"count": 40, "seed": 7, "grid": 30, "size": 30, "scale": 1e30}, 2, id="seed 7, huge"),
    ],
)
def test_it_is_what_the_slow_reference_says(soup, leaf_size):
    bvh = build(make_soup(**soup), leaf_size=leaf_size)
    overlap = measure_overlap(bvh, traversal_cost=1.2, intersection_cost=0.7)
    expected = slow_epo(bvh, 1.2, 0.7)
    assert expected > 0
    assert overlap.epo == pytest.approx(expected, rel=1e-9)
    assert overlap.triangle_count == bvh.mesh.face_count


def test_leaves_in_another_order_of_places_give_the_same_overlap():
    """A right tree need not list its leaves from left to right."""
    bvh = make_tree()
    nodes = bvh.nodes.copy()
    nodes["first"][[1, 3, 4]] = [2, 1, 0]
    swapped = Bvh(nodes, np.array([1, 3, 0, 2], np.int32), bvh.mesh)
    validate_tree(swapped)
    assert measure_overlap(swapped).epo == measure_overlap(bvh).epo


def test_a_sample_is_counted_and_near():
    bvh = build(make_soup(5000, 1, grid=300, size=30))
    whole, sample = measure_overlap(bvh), measure_overlap(bvh, sample=1000)
    assert (whole.triangle_count, sample.triangle_count) == (5000, 1000)
    assert sample.epo != whole.epo
    assert sample.epo == pytest.approx(whole.epo, rel=0.05)


@pytest.mark.parametrize("sample", [5000, 5001, 10**9])
def test_a_sample_of_all_is_the_whole(sample):
    bvh = build(make_soup(5000, 1, grid=300, size=30))
    assert measure_overlap(bvh, sample=sample) == measure_overlap(bvh)


@pytest.mark.parametrize("sample", [0, -1])
def test_an_empty_sample_is_refused(sample):
    with pytest.raises(ConfigError, match=f"at least 1 triangle, not {sample}"):
        measure_overlap(make_tree(), sample=sample)

"""Every crossing of a ray, in order, each once; and all queries agree."""

import numpy as np
import pytest

from clbvh import build
from clbvh.geometry import Mesh
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.structs import NO_PRIM

from ..rays import aim, as_float32, centred, edge_midpoints, hard_rays
from ..soup import make_soup
from .casting import open_caster

RAYS = 20_000
SHAPES = {"icosphere": 500, "knot": 1200, "terrain": 800, "blobs": 640, "boxes": 600}


def check_queries(cast, rays, **limits):
    """Hold all queries against each other; return the hits, and where each ray's begin."""
    hits, offsets = cast("all_hits", *rays, **limits)
    counts = np.diff(offsets)
    np.testing.assert_array_equal(cast("count_hits", *rays, **limits), counts)
    np.testing.assert_array_equal(cast("any_hit", *rays, **limits), counts > 0)
    closest = cast("closest_hit", *rays, **limits)
    np.testing.assert_array_equal(closest["prim_id"] != NO_PRIM, counts > 0)
    assert hits[offsets[:-1][counts > 0]].tobytes() == closest[counts > 0].tobytes()
    # In order along each ray, and no triangle twice.
    ray = np.repeat(np.arange(len(counts)), counts)
    np.testing.assert_array_equal(np.lexsort((hits["prim_id"], hits["t"], ray)), np.arange(len(hits)))
    assert len(np.unique(np.stack((ray, hits["prim_id"])), axis=1).T) == len(hits)
    return hits, offsets


@pytest.mark.parametrize("shape", SHAPES)
def test_all_queries_agree_with_and_without_a_tree(session, shape):
    mesh = centred(make_shape(shape, triangles=SHAPES[shape]))
    rays = hard_rays(mesh, RAYS, np.random.default_rng(60))
    with open_caster(session, mesh, build(mesh)) as cast, open_caster(session, mesh, None) as brute:
        hits, offsets = check_queries(cast, rays)
        assert hits.tobytes() == brute("all_hits", *rays)[0].tobytes()
        assert np.diff(offsets).max() > 1
        limits = {"t_min": 0.4, "t_max": 0.9}
        between, _ = check_queries(cast, rays, **limits)
        kept = (hits["t"] >= np.float32(0.4)) & (hits["t"] <= np.float32(0.9))
        assert hits[kept].tobytes() == between.tobytes()
        assert 0 < len(between) < len(hits)


@pytest.mark.parametrize("shape", ["icosphere", "knot", "blobs", "boxes"])
def test_a_line_leaves_a_closed_mesh_as_often_as_it_enters(session, shape):
    """From far outside, through vertices, edges and in the planes of faces: silhouettes are crossed twice or never."""
    mesh = centred(make_shape(shape, triangles=SHAPES[shape]))
    origins, directions = hard_rays(mesh, RAYS, np.random.default_rng(61))
    size = float(np.ptp(mesh.vertices, axis=0).max())
    reach = 8 * size / np.abs(directions).max(axis=1, keepdims=True)
    with open_caster(session, mesh, build(mesh)) as cast:
        counts = cast("count_hits", as_float32(origins - reach * directions), directions)
    assert (counts % 2 == 0).all()
    assert len(np.unique(counts)) > 1


def test_the_way_out_of_a_convex_mesh_is_crossed_once(session):
    mesh = centred(make_shape("icosphere", triangles=5120))
    generator = np.random.default_rng(62)
    targets = np.concatenate((mesh.vertices.astype(np.float64), edge_midpoints(mesh)))
    for inner in (np.zeros(targets.shape), generator.uniform(-0.2, 0.2, targets.shape)):
        with open_caster(session, mesh, build(mesh)) as cast:
            counts = cast("count_hits", *aim(inner, targets))
        np.testing.assert_array_equal(counts, 1)


def test_the_nearest_ones_are_kept(session):
    # Many crossings at equal distances: copies of triangles on a small grid.
    mesh = centred(make_soup(600, seed=3, grid=6, size=3, copies=0.3, degenerate=0.2))
    rays = hard_rays(mesh, RAYS, np.random.default_rng(63))
    with open_caster(session, mesh, build(mesh)) as cast:
        hits, offsets = check_queries(cast, rays)
        assert np.diff(offsets).max() > 20
        for max_hits in (1, 2, 7):
            fewer, their_offsets = cast("all_hits", *rays, max_hits=max_hits)
            np.testing.assert_array_equal(np.diff(their_offsets), np.minimum(np.diff(offsets), max_hits))
            ray = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
            assert fewer.tobytes() == hits[np.arange(len(hits)) - offsets[ray] < max_hits].tobytes()


@pytest.mark.parametrize("count", [1, 2])
def test_a_triangle_of_the_smallest_tree_is_crossed_once(session, count):
    # The box of the child that is not there lies at the end of the number range; a diagonal ray would get there.
    corners = np.array([[1, 1, 1], [2, 1, 1], [1, 2, 1]]) + np.arange(count)[:, None, None]
    mesh = Mesh.from_arrays(corners.reshape(-1, 3).astype(float), np.arange(3 * count).reshape(-1, 3))
    bvh = build(mesh, leaf_size=4, traversal_cost=100)
    assert bvh.node_count == 1
    with open_caster(session, mesh, bvh) as cast:
        counts = cast("count_hits", [[0.1, 0.05, 0]], [[1, 1, 1]])
    assert counts.tolist() == [count]


def test_thousands_of_crossings_of_one_ray(session):
    count = 5000
    heights = np.random.default_rng(64).permutation(count).astype(np.float64)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float) + heights[:, None, None] * [0, 0, 1]
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    with open_caster(session, mesh, build(mesh)) as cast:
        hits, offsets = cast("all_hits", [[0.25, 0.25, -1]] * 2, [[0, 0, 1], [0, 0, -1]])
    assert offsets.tolist() == [0, count, count]
    np.testing.assert_array_equal(hits["t"], 1 + np.arange(count))
    np.testing.assert_array_equal(heights[hits["prim_id"]], np.arange(count))

"""Whole builds: small, degenerate and ill-spaced meshes, quality, and who does the work."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, SubtreePool, build, sah_cost, validate_tree
from clbvh.builders import build as build_module
from clbvh.builders.options import DEFAULT_QUALITY, FAST_QUALITY, MAX_DEPTH, QUALITIES
from clbvh.errors import ConfigError, MeshError
from clbvh.geometry.shapes.make_shape import make_shape

from ...soup import make_soup
from .reference_builder import sah_cost_by_reference

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


def from_corners(corners):
    """Return the mesh of (n, 3, 3) corners."""
    corners = np.asarray(corners, float)
    return Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def make_nested(count):
    """Return triangles of all sizes with one centroid."""
    corners = np.arange(1, count + 1)[:, None, None] * np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1]])
    return from_corners(corners)


def make_exponential(ratio, copies=1):
    """Return triangles on three axes, each `ratio` times as large and as far away as the one before."""
    distances = 1e-32 * ratio ** np.arange(int(math.log(1e66, ratio)))
    corners = np.zeros((len(distances), 3, 3))
    number = np.arange(len(distances))
    corners[number, :, number % 3] = distances[:, None]
    corners += distances[:, None, None] * 1e-3 * np.eye(3)
    corners = np.repeat(corners, copies, axis=0)
    return from_corners(np.concatenate([corners, -corners]))


def make_line(direction, count=500):
    """Return triangles without area along a line."""
    steps = np.random.default_rng(1).integers(0, 1000, (count, 3, 1))
    return from_corners(steps * np.array(direction))


def make_plane(axis):
    corners = np.random.default_rng(2).random((500, 3, 3))
    corners[:, :, axis] = 3
    return from_corners(corners)


def make_giant_among_dwarfs():
    dwarfs = np.random.default_rng(3).random((1000, 1, 3)) + 1e-3 * np.random.default_rng(4).random((1000, 3, 3))
    return from_corners(np.concatenate([dwarfs, 1e6 * TRIANGLE[None]]))


MESHES = {
    "one": lambda: make_soup(1, seed=1),
    "two": lambda: make_soup(2, seed=1),
    "three": lambda: make_soup(3, seed=1),
    "equal centroids": lambda: make_nested(500),
    "copies of one": lambda: from_corners(np.tile(TRIANGLE, (5000, 1, 1))),
    "copies of two": lambda: from_corners(np.concatenate([np.tile(TRIANGLE, (999, 1, 1)), [TRIANGLE + 5] * 1000])),
    "points": lambda: from_corners(np.random.default_rng(5).random((500, 1, 3)).repeat(3, axis=1)),
    "one point": lambda: from_corners(np.ones((500, 3, 3))),
    "along x": lambda: make_line([1, 0, 0]),
    "along a diagonal": lambda: make_line([1, 2, -3]),
    "flat in x": lambda: make_plane(0),
    "flat in z": lambda: make_plane(2),
    "one huge among tiny": make_giant_among_dwarfs,
    "scales of 1.5": lambda: make_exponential(1.5),
    "scales of 1.5, copies": lambda: make_exponential(1.5, copies=20),
    "scales of 2": lambda: make_exponential(2),
    "scales of 16": lambda: make_exponential(16),
    "1e-30": lambda: make_soup(1000, seed=6, scale=1e-33),
    "below normal numbers": lambda: make_soup(1000, seed=6, scale=1e-43),
    "1e30": lambda: make_soup(1000, seed=6, scale=1e27),
    "1e38": lambda: make_soup(1000, seed=6, scale=1.6e35),
}


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@pytest.mark.parametrize("leaf_size", [1, 4])
@pytest.mark.parametrize("name", MESHES)
def test_every_mesh_gives_a_right_tree(name, leaf_size, quality, pool):
    mesh = MESHES[name]()
    bvh = build(mesh, leaf_size=leaf_size, quality=quality)
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
    parallel = build(mesh, leaf_size=leaf_size, pool=pool, task_threshold=50, quality=quality)
    assert parallel.nodes.tobytes() == bvh.nodes.tobytes()
    assert parallel.prim_ids.tobytes() == bvh.prim_ids.tobytes()


def test_what_is_no_mesh_does_not_get_here():
    with pytest.raises(MeshError, match="no faces"):
        Mesh.from_arrays(TRIANGLE, np.empty((0, 3), int))
    with pytest.raises(MeshError, match="not finite"):
        Mesh.from_arrays(np.full((3, 3), np.nan), [[0, 1, 2]])


@pytest.mark.parametrize(
    ("count", "leaf_size", "nodes"), [(1, 1, 1), (1, 4, 1), (2, 1, 3), (3, 1, 5), (2, 4, 1), (3, 4, 1)]
)
def test_a_few_equal_triangles_have_a_known_tree(count, leaf_size, nodes):
    bvh = build(from_corners(np.tile(TRIANGLE, (count, 1, 1))), leaf_size=leaf_size)
    assert bvh.node_count == nodes
    assert bvh.prim_ids.tolist() == list(range(count))


@pytest.mark.parametrize("count", [2, 3, 1000, 1024, 1025])
def test_copies_are_halved(count):
    bvh = build(from_corners(np.tile(TRIANGLE, (count, 1, 1))), leaf_size=1)
    assert bvh.depth == math.ceil(math.log2(count))


def test_the_depth_limit_is_reached_and_kept():
    bvh = build(make_exponential(1.5), leaf_size=1)
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=1)
    assert bvh.depth == MAX_DEPTH
    # Most of it was split by cost, and not by halves from the beginning.
    assert sah_cost(bvh) < 100


def test_two_clusters_are_parted_at_the_root():
    corners = np.random.default_rng(7).random((200, 3, 3))
    corners[100:] += 1000
    bvh = build(from_corners(corners))
    assert sorted(bvh.prim_ids[: len(corners) // 2]) == list(range(100))
    assert (bvh.nodes["aabb_max"][1] < bvh.nodes["aabb_min"][2]).all()


def test_primitives_ascend_within_every_leaf():
    bvh = build(make_soup(3000, seed=8, copies=0.5), leaf_size=16, traversal_cost=10)
    leaves = bvh.nodes[bvh.nodes["count"] > 1]
    assert len(leaves) > 100
    for first, count in zip(leaves["first"], leaves["count"], strict=True):
        assert (np.diff(bvh.prim_ids[first : first + count]) > 0).all()


@pytest.mark.parametrize(("option", "low", "high"), [("leaf_size", 1, 32), ("traversal_cost", 0.1, 10.0)])
def test_options_reach_the_tree(option, low, high, pool):
    mesh = make_soup(2000, seed=9, size=200)
    if option == "traversal_cost":
        few, many = build(mesh, leaf_size=8, **{option: high}), build(mesh, leaf_size=8, **{option: low})
    else:
        few, many = build(mesh, traversal_cost=4.0, **{option: high}), build(mesh, traversal_cost=4.0, **{option: low})
    assert few.node_count < many.node_count


def test_more_bins_find_better_splits():
    mesh = make_shape("knot", triangles=5000, seed=1)
    costs = [sah_cost(build(mesh, bins=bins)) for bins in (2, 4, 16)]
    assert costs[0] > costs[1] > costs[2]


@pytest.mark.parametrize(("shape", "triangles"), [("knot", 6_000), ("blobs", 3_000)])
def test_the_tree_is_as_good_as_that_of_a_plain_builder(shape, triangles):
    mesh = make_shape(shape, triangles=triangles, seed=1)
    assert sah_cost(build(mesh)) <= 1.01 * sah_cost_by_reference(mesh)


class Untouchable:
    """A pool that fails when it is used."""

    def __getattr__(self, name):
        raise AssertionError(f"pool.{name} was used")


@pytest.mark.parametrize(
    ("face_count", "threads"), [(2, 1), (19_999, 1), (20_000, 2), (60_000, 6), (90_000, 7), (10**7, 7)]
)
def test_a_thread_is_started_for_every_ten_thousand_triangles(face_count, threads, monkeypatch):
    monkeypatch.setattr(build_module, "usable_cores", lambda: 7)
    options = BuildOptions()
    assert build_module.choose_workers(face_count, "sah", options, None) == threads
    assert build_module.choose_workers(face_count, "flat", options, 3) == min(threads, 3)
    assert build_module.choose_workers(face_count, "sequential", options, 3) == 1
    assert build_module.choose_workers(face_count, "sah", BuildOptions(task_threshold=1), 5) == 5


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_bytes_do_not_depend_on_the_number_of_threads(quality):
    mesh = make_shape("knot", triangles=60_000, seed=1)
    alone = build(mesh, workers=1, quality=quality)
    for options in ({}, {"workers": 3}, {"workers": 5, "task_threshold": 777}):
        bvh = build(mesh, quality=quality, **options)
        assert bvh.nodes.tobytes() == alone.nodes.tobytes(), options
        assert bvh.prim_ids.tobytes() == alone.prim_ids.tobytes(), options


def test_a_build_leaves_no_thread():
    before = threading.active_count()
    build(make_soup(1000, seed=1), workers=3, task_threshold=10)
    assert threading.active_count() == before


@pytest.mark.parametrize(("workers", "message"), [(0, "must be 1 to 1024, not 0"), (2.5, "must be a whole number")])
def test_a_wrong_number_of_workers_is_refused(workers, message):
    with pytest.raises(ConfigError, match=message):
        build(make_soup(10, seed=1), workers=workers)


def test_workers_and_a_pool_exclude_each_other():
    with pytest.raises(ConfigError, match="leave workers or pool out"):
        build(make_soup(10, seed=1), workers=2, pool=Untouchable())


def test_a_small_mesh_does_not_touch_the_pool():
    bvh = build(make_soup(100, seed=10), pool=Untouchable())
    assert list(bvh.timings_ms) == ["metadata", "top", "subtrees", "compact"]


def test_from_a_size_on_the_pool_builds(monkeypatch, pool):
    monkeypatch.setattr(build_module, "PRIMS_PER_WORKER", 50)
    begin = time.perf_counter()
    bvh = build(make_soup(100, seed=10), pool=pool)
    wall_ms = 1e3 * (time.perf_counter() - begin)
    assert list(bvh.timings_ms) == ["metadata", "top", "subtrees", "compact"]
    assert all(lap > 0 for lap in bvh.timings_ms.values())
    assert sum(bvh.timings_ms.values()) <= wall_ms
    with pytest.raises(AssertionError, match="was used"):
        build(make_soup(100, seed=10), pool=Untouchable())
    build(make_soup(99, seed=10), pool=Untouchable())


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@pytest.mark.parametrize("name", ["copies", "nested", "line", "exponential"])
def test_no_mesh_takes_quadratic_time(name, quality):
    count = 100_000
    mesh = {
        "copies": lambda: from_corners(np.broadcast_to(TRIANGLE, (count, 3, 3))),
        "nested": lambda: make_nested(count),
        "line": lambda: make_line([1, 0, 0], count),
        "exponential": lambda: make_exponential(1.5, copies=count // 748),
    }[name]()
    build(make_soup(10, seed=11), quality=quality)  # the compiled code is loaded
    begin = time.process_time()
    bvh = build(mesh, quality=quality)
    # 0.3 s at most on a 2-core x86-64 server; 1e10 steps would take longer than this.
    assert time.process_time() - begin < 4
    assert bvh.depth <= MAX_DEPTH


def test_the_mesh_is_not_changed_and_is_part_of_the_tree():
    mesh = make_soup(1000, seed=12)
    before = mesh.vertices.tobytes(), mesh.faces.tobytes()
    bvh = build(mesh)
    assert bvh.mesh is mesh
    assert (mesh.vertices.tobytes(), mesh.faces.tobytes()) == before

"""Whole builds by every builder: right trees of hard shapes, the same bytes whoever builds, quality, time, options."""

from __future__ import annotations

import dataclasses
import math
import threading
import time

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, SubtreePool, build, make_shape, sah_cost, validate_tree
from clbvh.builders import build as build_module
from clbvh.builders.build import BUILDERS, build_tree, leaf_limit
from clbvh.builders.options import MAX_DEPTH, QUALITIES
from clbvh.errors import ConfigError

from ...soup import make_soup
from .shapes import SHAPES, copies, exponential, from_corners, line, nested

RECIPES = [("sah", quality) for quality in QUALITIES] + [(name, "default") for name in BUILDERS[1:]]


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


@pytest.mark.parametrize(("builder", "quality"), RECIPES)
def test_every_shape_gives_a_right_tree_and_the_same_bytes_whoever_builds_it(builder, quality, pool):
    for (name, make), leaf_size in zip(SHAPES.items(), [1, 4] * len(SHAPES), strict=False):
        shape, options = make(), BuildOptions(leaf_size=leaf_size, frontier=16, quality=quality)
        bvh = build_tree(shape, builder, None, options)
        assert bvh.shape is shape
        validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_limit(builder, options))
        for threshold, workers, who in ((1, 3, None), (60, None, pool)):
            other = build_tree(shape, builder, who, dataclasses.replace(options, task_threshold=threshold), workers)
            assert bytes_of(other) == bytes_of(bvh), (name, threshold, workers)


def test_a_build_leaves_no_thread(mesh):
    build(mesh, workers=3, task_threshold=100)  # the compiled code is loaded
    before = threading.active_count()
    build(mesh, workers=3, task_threshold=100)
    assert threading.active_count() == before


@pytest.mark.parametrize(("builder", "quality"), RECIPES)
def test_the_mesh_is_not_changed_and_may_be_one_that_nobody_may_write_to(builder, quality):
    mesh = make_soup(300, seed=5)
    bvh = build(mesh, builder=builder, quality=quality)
    mesh.local_vertices.flags.writeable = mesh.faces.flags.writeable = False
    assert bytes_of(build(mesh, builder=builder, quality=quality)) == bytes_of(bvh)


@pytest.mark.parametrize("quality", QUALITIES)
def test_primitives_ascend_within_every_leaf(quality):
    bvh = build(make_soup(3000, seed=8, copies=0.5), leaf_size=16, traversal_cost=10, quality=quality)
    leaves = bvh.nodes[bvh.nodes["count"] > 1]
    assert len(leaves) > 100
    for first, count in zip(leaves["first"], leaves["count"], strict=True):
        assert (np.diff(bvh.prim_ids[first : first + count]) > 0).all()


@pytest.mark.parametrize("shape", ["knot", "blobs", "terrain", "boxes"])
def test_trees_are_as_good_as_their_quality_says(shape):
    mesh = make_shape(shape, triangles=5000, seed=1)
    fast, default, high = (sah_cost(build(mesh, quality=quality)) for quality in QUALITIES)
    assert high < default < fast < 1.2 * default
    assert sah_cost(build(mesh, builder="bin")) < 1.1 * sah_cost(build(mesh, builder="median"))


@pytest.mark.parametrize(
    ("builder", "quality", "phases"),
    [
        ("sah", "fast", "treelets subtrees compact"),
        ("sah", "high", "metadata top subtrees compact finer-bins expand_leaves reinsert collapse"),
        ("range", "default", "share top subtrees convert"),
        ("flatten", "default", "share metadata top subtrees flatten"),
    ],
)
def test_each_phase_is_timed(builder, quality, phases, mesh, pool):
    for options in ({}, {"pool": pool, "task_threshold": 500}):
        begin = time.perf_counter()
        timings = build(mesh, builder=builder, quality=quality, **options).timings_ms
        wall_ms = 1e3 * (time.perf_counter() - begin)
        assert [name.replace(" ", "-") for name in timings] == phases.split()
        assert all(lap > 0 for lap in timings.values())
        assert sum(timings.values()) <= wall_ms


@pytest.mark.parametrize(("builder", "quality"), [("sah", "fast"), ("sah", "default"), ("median", "default"),
                                                  ("bin", "default"), ("flat", "default")])  # fmt: skip
def test_no_mesh_takes_quadratic_time(builder, quality):
    build(make_soup(10, seed=1), builder=builder, quality=quality)  # the compiled code is loaded
    for mesh in (copies(50_000), nested(50_000), line(50_000), exponential(copies=60)):
        begin = time.process_time()
        build(mesh, builder=builder, quality=quality, leaf_size=1)
        # 0.4 s at most on a 2-core x86-64 server; 2.5e9 steps would take longer than this.
        assert time.process_time() - begin < 3


class Untouchable:
    """A pool that fails when it is used."""

    def __getattr__(self, name):
        raise AssertionError(f"pool.{name} was used")


def test_small_meshes_and_the_first_variant_leave_the_pool_alone(pool, monkeypatch):
    mesh = make_soup(100, seed=10)
    build(mesh, pool=Untouchable())
    build(mesh, builder="sequential", pool=Untouchable())
    monkeypatch.setattr(build_module, "PRIMS_PER_WORKER", 50)
    build(make_soup(99, seed=10), pool=Untouchable())
    assert bytes_of(build(mesh, pool=pool)) == bytes_of(build(mesh))
    for builder in [name for name in BUILDERS if name != "sequential"]:
        with pytest.raises(AssertionError, match="was used"):
            build(mesh, builder=builder, pool=Untouchable())


def test_the_ends_of_each_range_are_allowed_and_numpy_numbers_become_plain_ones():
    for name, values in {
        "bins": (2, 64, None),
        "leaf_size": (1, 255),
        "traversal_cost": (1e-300, 1e300),
        "task_threshold": (1, 2**40, None),
        "frontier": (4, 8192),
    }.items():
        for value in values:
            assert getattr(BuildOptions(**{name: value}), name) == value
    options = BuildOptions(np.int64(8), np.uint8(3), np.float32(2), np.int16(100), np.uint16(500))
    assert [type(value) for value in dataclasses.astuple(options)] == [int, int, float, int, int, str]


def test_what_lies_outside_is_refused_by_name_and_value():
    wrong = [(name, value) for name in ("leaf_size", "frontier", "traversal_cost") for value in (None, 0, "8", [8])]
    wrong += [("bins", value) for value in (1, 65, -16, True, 8.5, np.float64(8))]
    wrong += [("leaf_size", 256), ("frontier", 3), ("frontier", 8193), ("task_threshold", 0), ("task_threshold", 8.0)]
    wrong += [("traversal_cost", value) for value in (-1.0, math.inf, math.nan, True, 8 + 0j)]
    wrong += [("quality", value) for value in ("best", "Default", "", None, ["default"])]
    wrong += [("workers", value) for value in (0, 1025, 2.5, True)] + [("builder", "magic")]
    for name, value in wrong:
        with pytest.raises(ConfigError, match=f"^{name} must be ") as caught:
            build(from_corners(np.eye(3)[None]), **{name: value})
        assert str(value) in str(caught.value)
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    with pytest.raises(ConfigError, match="the builder median has one quality, default: leave 'fast' out"):
        build(mesh, builder="median", quality="fast")
    with pytest.raises(ConfigError, match="leave workers or pool out"):
        build(mesh, workers=2, pool=Untouchable())

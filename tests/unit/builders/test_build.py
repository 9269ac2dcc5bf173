"""Whole builds by every builder: right trees of hard shapes, the same bytes whoever builds, quality, time, options."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest

from clbvh import BuildOptions, ConfigError, Mesh, PoolError, SubtreePool, build, make_shape, sah_cost, validate_tree
from clbvh.builders import build as build_module
from clbvh.builders.build import BUILDERS, build_tree, leaf_limit, plan_tree, plan_trees
from clbvh.builders.options import QUALITIES
from clbvh.geometry import joined_shapes
from clbvh.structs import MAX_DEPTH

from ...soup import make_soup
from .shapes import SHAPES, copies, exponential, line, nested

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


def test_small_shapes_get_the_same_trees_together(monkeypatch):
    monkeypatch.setattr(joined_shapes, "_LEAST_SHAPES", 2)
    shapes = [make() for make in SHAPES.values()]
    for quality in ("default", "high"):
        expected = [bytes_of(plan_tree(shape, quality)) for shape in shapes]
        planned = plan_trees(shapes, quality)
        assert [plan.shape for plan in planned] == shapes
        assert list(map(bytes_of, planned)) == expected
    alone = []
    monkeypatch.setattr(build_module, "build_sah", lambda shape, *arguments: alone.append(shape) or Mock())
    plan_trees(shapes, "default")
    assert alone == [shape for shape in shapes if shape.prim_count > joined_shapes.MOST_PRIMS]


@pytest.mark.parametrize("shape", ["knot", "blobs", "terrain", "boxes"])
def test_trees_are_as_good_as_their_quality_says(shape):
    mesh = make_shape(shape, triangles=5000, seed=1)
    fast, default, high = (sah_cost(build(mesh, quality=quality)) for quality in QUALITIES)
    assert high < default
    assert fast < 1.2 * default
    assert sah_cost(build(mesh, builder="bin")) < 1.1 * sah_cost(build(mesh, builder="median"))


@pytest.mark.parametrize("recipe", [RECIPES[0], RECIPES[1], ("median", "default"), ("flat", "default")])
def test_no_mesh_takes_quadratic_time(recipe):
    builder, quality = recipe
    build(make_soup(10, seed=1), builder=builder, quality=quality)  # the compiled code is loaded
    for mesh in (copies(50_000), nested(50_000), line(50_000), exponential(copies=60)):
        begin = time.process_time()
        build(mesh, builder=builder, quality=quality, leaf_size=1)
        # 0.4 s at most on a 2-core x86-64 server; 2.5e9 steps would take longer than this.
        assert time.process_time() - begin < 3


def test_each_phase_is_timed_and_no_thread_is_left(mesh, pool):
    build(mesh, workers=3, task_threshold=100)  # the compiled code is loaded
    before = threading.active_count()
    for recipe, phases in (
        ({"quality": "fast"}, "open upload sort merge place download"),
        ({"quality": "high"}, "metadata top subtrees compact finer bins expand_leaves reinsert collapse"),
        ({"builder": "range"}, "share top subtrees convert"),
        ({"builder": "flatten"}, "share metadata top subtrees flatten"),
    ):
        for options in ({"workers": 3}, {"pool": pool, "task_threshold": 500}):
            begin = time.perf_counter()
            timings = build(mesh, **recipe, **options).timings_ms
            wall_ms = 1e3 * (time.perf_counter() - begin)
            assert " ".join(timings) == phases
            assert min(timings.values()) > 0
            assert sum(timings.values()) <= wall_ms
    assert threading.active_count() == before


def test_small_meshes_and_the_first_variant_leave_the_pool_alone(pool, monkeypatch):
    pool_is_closed = SubtreePool(workers=1)
    pool_is_closed.close()
    build(make_soup(100, seed=10), pool=pool_is_closed)
    build(make_soup(100, seed=10), builder="sequential", pool=pool_is_closed)
    monkeypatch.setattr(build_module, "PRIMS_PER_WORKER", 50)
    build(make_soup(99, seed=10), pool=pool_is_closed)
    with pytest.raises(PoolError, match="closed"):
        build(make_soup(100, seed=10), pool=pool_is_closed)


def test_keywords_change_the_options_that_are_given():
    mesh, options = make_soup(500, seed=11), BuildOptions(leaf_size=8, traversal_cost=9)
    wide, narrow = (build_tree(mesh, "sah", None, dataclasses.replace(options, leaf_size=size)) for size in (8, 4))
    assert bytes_of(build(mesh, options)) == bytes_of(wide) != bytes_of(narrow)
    assert bytes_of(build(mesh, options, leaf_size=4)) == bytes_of(narrow)


def test_what_lies_outside_is_refused_by_name_and_value():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    for name, values in {
        "bins": (1, 65, -16, True, 8.5, np.float64(8)),
        "leaf_size": (None, 0, "8", [8], 256),
        "frontier": (None, 3, 8193),
        "task_threshold": (0, 8.0),
        "traversal_cost": (None, 0, "8", -1.0, math.inf, math.nan, True, 8 + 0j),
        "quality": ("best", "Default", "", None, ["default"]),
        "workers": (0, 1025, 2.5, True),
        "builder": ("magic",),
    }.items():
        for value in values:
            with pytest.raises(ConfigError, match=f"^{name} must be ") as caught:
                build(mesh, **{name: value})
            assert str(value) in str(caught.value)
    with pytest.raises(ConfigError, match="the builder median has one quality, default: leave 'fast' out"):
        build(mesh, builder="median", quality="fast")
    with pytest.raises(ConfigError, match="leave workers or pool out"):
        build(mesh, workers=2, pool=SubtreePool)
    with pytest.raises(ConfigError, match=r"options must be a clbvh\.BuildOptions, not a str"):
        build(mesh, "high")
    with pytest.raises(ConfigError, match=r"there is no setting 'leafsize': did you mean 'leaf_size'\?"):
        build(mesh, leafsize=4)
    options = BuildOptions(np.int64(2), np.uint8(255), np.float32(2), np.int16(1), np.uint16(8192))
    assert [type(value) for value in dataclasses.astuple(options)] == [int, int, float, int, int, str]

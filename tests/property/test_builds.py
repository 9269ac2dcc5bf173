"""Any mesh, any options, any builder: a right tree, and the same bytes for any number of workers."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, strategies as st

from clbvh import BuildOptions, Mesh, build, sah_cost, validate_tree
from clbvh.builders.build import build_tree
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.structs import MAX_DEPTH

from ..profiles import examples
from ..soup import make_soup

# Sizes around powers of two are where halves and slices go wrong.
SIZES = st.integers(1, 40) | st.sampled_from([63, 64, 65, 255, 256, 257, 1023, 1025]) | st.integers(40, 3000)

SOUPS = st.builds(
    make_soup,
    count=SIZES,
    seed=st.integers(0, 2**32 - 1),
    grid=st.sampled_from([0, 1, 3, 30, 1000]),
    size=st.sampled_from([0, 1, 20, 1000]),
    copies=st.sampled_from([0.0, 0.3, 0.95]),
    degenerate=st.sampled_from([0.0, 0.3, 1.0]),
    scale=st.sampled_from([1.0, 1e-30, 1e30, -0.1]),
)

# Corner by corner, so that a failure shrinks to a few triangles.
COORDINATES = st.sampled_from([-2.0, -1.0, -0.0, 0.0, 0.5, 1.0, 3.0, 1e-40, -1e-40])
CORNERS = st.tuples(COORDINATES, COORDINATES, COORDINATES)
HAND_PICKED = st.lists(st.tuples(CORNERS, CORNERS, CORNERS), min_size=1, max_size=24).map(
    lambda corners: Mesh.from_arrays(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)).reshape(-1, 3))
)
MESHES = SOUPS | HAND_PICKED

LEAF_SIZES = st.sampled_from([1, 2, 4, 8, 255])
QUALITIES = st.sampled_from(["fast", "default", "high"])
BUILDS = st.one_of(
    QUALITIES.map(lambda name: {"quality": name}), st.sampled_from([{"builder": name} for name in VARIANTS])
)

# Variants of the ladder that look for the same split, by different ways.
SAME_TREE = (("sequential", "naive", "range", "cached", "median"), ("bin", "atomic", "flatten", "flat"))


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


def assert_right(bvh, leaf_size):
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
    starts = set(bvh.nodes["first"][bvh.nodes["count"] > 0].tolist())
    descents = np.flatnonzero(np.diff(bvh.prim_ids) < 0) + 1
    assert starts.issuperset(descents.tolist()), "the primitives of a leaf must ascend"


@examples(short=150, long=3000)
@given(
    mesh=MESHES,
    leaf_size=LEAF_SIZES,
    bins=st.sampled_from([2, 3, 8, 16, 64]),
    cost=st.sampled_from([0.01, 1.0, 8.0]),
    quality=QUALITIES,
)
def test_a_tree_is_right_and_high_quality_is_never_costlier(mesh, leaf_size, bins, cost, quality):
    options = {"leaf_size": leaf_size, "bins": bins, "traversal_cost": cost}
    bvh = build(mesh, quality=quality, **options)
    assert_right(bvh, leaf_size)
    if quality == "high":
        assert sah_cost(bvh, traversal_cost=cost) <= sah_cost(build(mesh, **options), traversal_cost=cost)


@examples(short=40, long=1000)
@given(mesh=MESHES, leaf_size=LEAF_SIZES, threshold=st.sampled_from([1, 7, 64, 10**6]), how=BUILDS)
@example(mesh=make_soup(3000, seed=1), leaf_size=1, threshold=30, how={"quality": "default"})
@example(mesh=make_soup(3000, seed=1), leaf_size=1, threshold=30, how={"builder": "atomic"})
@example(mesh=make_soup(3000, seed=1), leaf_size=1, threshold=30, how={"builder": "naive"})
def test_the_bytes_do_not_depend_on_workers_nor_thresholds(mesh, leaf_size, threshold, how, pools):
    serial = build(mesh, leaf_size=leaf_size, workers=1, **how)
    for workers, pool in pools.items():
        for who in ({"pool": pool}, {"workers": workers}):
            shared = build(mesh, leaf_size=leaf_size, task_threshold=threshold, **who, **how)
            assert bytes_of(shared) == bytes_of(serial), who


@examples(short=30, long=1000)
@given(mesh=MESHES, leaf_size=st.sampled_from([1, 2, 4, 255]), bins=st.sampled_from([2, 3, 8, 64]))
def test_variants_that_share_a_split_make_the_same_right_tree(mesh, leaf_size, bins):
    options = BuildOptions(leaf_size=leaf_size, bins=bins, frontier=max(5, leaf_size))
    for names in SAME_TREE:
        trees = [build_tree(mesh, name, None, options) for name in names]
        assert_right(trees[0], leaf_size)
        assert len({bytes_of(tree) for tree in trees}) == 1
    validate_tree(build_tree(mesh, "frontier", None, options), max_depth=MAX_DEPTH, max_leaf_size=options.frontier)


def test_triangles_that_all_overlap_take_no_quadratic_time():
    """A search that visits the whole tree from every node takes 4e8 steps each way, and minutes."""
    assert_right(build(make_soup(20_000, 3, grid=20, size=1000), quality="high"), 4)

"""Any mesh, any options, any builder: a right tree, and the same bytes for any number of workers."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, strategies as st

from clbvh import BuildOptions, Mesh, Spheres, build, make_shape, sah_cost, validate_tree
from clbvh.builders.build import build_tree
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.builders.options import MAX_DEPTH

from ..profiles import examples
from ..rays import mesh_as_on_device
from ..soup import make_soup

# Sizes around powers of two are where halves and slices go wrong.
SIZES = st.one_of(
    st.integers(1, 40),
    st.sampled_from([63, 64, 65, 255, 256, 257, 1023, 1025]),
    st.integers(40, 3000),
)

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
    lambda triangles: Mesh.from_arrays(
        np.array(triangles, np.float32).reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    )
)
MESHES = st.one_of(SOUPS, HAND_PICKED)

OPTIONS = st.fixed_dictionaries(
    {
        "bins": st.sampled_from([2, 3, 8, 16, 64]),
        "leaf_size": st.sampled_from([1, 2, 4, 8, 255]),
        "traversal_cost": st.sampled_from([0.01, 1.0, 8.0]),
    }
)
QUALITIES = st.sampled_from(["fast", "default", "high"])

# Variants of the ladder that look for the same split, by different ways.
SAME_TREE = (("sequential", "naive", "range", "cached", "median"), ("bin", "atomic", "flatten", "flat"))
BUILDERS = st.sampled_from([*VARIANTS, "sah"])


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


def assert_right(bvh, leaf_size):
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
    starts = set(bvh.nodes["first"][bvh.nodes["count"] > 0].tolist())
    descents = np.flatnonzero(np.diff(bvh.prim_ids) < 0) + 1
    assert starts.issuperset(descents.tolist()), "the primitives of a leaf must ascend"


@examples(short=150, long=3000)
@given(mesh=MESHES, options=OPTIONS, quality=QUALITIES)
def test_a_tree_is_right_and_high_quality_is_never_costlier(mesh, options, quality):
    bvh = build(mesh, quality=quality, **options)
    assert_right(bvh, options["leaf_size"])
    if quality == "high":
        cost = {"traversal_cost": options["traversal_cost"]}
        assert sah_cost(bvh, **cost) <= sah_cost(build(mesh, **options), **cost)


@examples(short=40, long=600)
@given(mesh=MESHES, options=OPTIONS, quality=QUALITIES)
@example(mesh=make_soup(3000, seed=1), options={"leaf_size": 1}, quality="default")
def test_the_bytes_do_not_depend_on_workers_nor_thresholds(mesh, options, quality, pools):
    serial = build(mesh, quality=quality, **options)
    for workers, pool in pools.items():
        for threshold in (1, 7, 64, 10**6):
            shared = build(mesh, pool=pool, task_threshold=threshold, quality=quality, **options)
            assert bytes_of(shared) == bytes_of(serial), f"{workers} workers, threshold {threshold}"


@examples(short=30, long=1000)
@given(mesh=MESHES, leaf_size=st.sampled_from([1, 2, 4, 255]), bins=st.sampled_from([2, 3, 8, 64]))
def test_variants_that_share_a_split_make_the_same_right_tree(mesh, leaf_size, bins):
    options = BuildOptions(leaf_size=leaf_size, bins=bins, frontier=max(5, leaf_size))
    for names in SAME_TREE:
        trees = [build_tree(mesh, name, None, options) for name in names]
        assert_right(trees[0], leaf_size)
        assert len({bytes_of(tree) for tree in trees}) == 1
    validate_tree(build_tree(mesh, "frontier", None, options), max_depth=MAX_DEPTH, max_leaf_size=options.frontier)


@examples(short=12, long=400)
@given(mesh=MESHES, frontier=st.sampled_from([4, 64, 8192]), name=BUILDERS, threshold=st.sampled_from([1, 30, 10**6]))
@example(mesh=make_soup(3000, seed=1), frontier=8192, name="atomic", threshold=30)
@example(mesh=make_soup(3000, seed=1), frontier=8192, name="naive", threshold=30)
def test_the_bytes_of_a_variant_do_not_depend_on_workers(mesh, frontier, name, threshold, pools):
    options = BuildOptions(leaf_size=1, frontier=frontier, task_threshold=threshold)
    serial = build_tree(mesh, name, None, options)
    for workers, pool in pools.items():
        in_threads = build_tree(mesh, name, None, options, workers)
        assert bytes_of(build_tree(mesh, name, pool, options)) == bytes_of(in_threads) == bytes_of(serial), workers


@examples(short=40, long=500)
@given(mesh=SOUPS, shift=st.sampled_from([-3, 1, 6]), quality=QUALITIES)
def test_a_power_of_two_as_unit_of_length_does_not_matter(mesh, shift, quality):
    """Scaling by it is exact, so every comparison comes out the same."""
    scale = np.float32(2.0**shift)
    scaled = mesh_as_on_device(mesh.local_vertices * scale, mesh.faces)
    before, after = build(mesh, quality=quality), build(scaled, quality=quality)
    assert before.prim_ids.tobytes() == after.prim_ids.tobytes()
    for field in ("aabb_min", "aabb_max"):
        assert (before.nodes[field] * scale == after.nodes[field]).all()


def test_workers_that_share_a_large_tree_give_the_same_bytes(pools):
    generator = np.random.default_rng(1)
    dust = Spheres(generator.uniform(-2, 2, (30_000, 3)), generator.uniform(0.001, 0.01, 30_000))
    for shape, builder in ((make_shape("palace", triangles=60_000), "high"), (dust, "sah")):
        for workers, pool in pools.items():
            if builder == "high":
                alone, shared = build(shape, quality="high"), build(shape, quality="high", pool=pool)
                assert_right(alone, 4)
            else:
                options = BuildOptions(task_threshold=5000)
                alone, shared = (build_tree(shape, builder, one, options) for one in (None, pool))
            assert bytes_of(shared) == bytes_of(alone), workers


def test_triangles_that_all_overlap_take_no_quadratic_time():
    """A search that visits the whole tree from every node takes 4e8 steps each way, and minutes."""
    assert_right(build(make_soup(20_000, 3, grid=20, size=1000), quality="high"), 4)

"""Any mesh, any options: a right tree, and the same bytes for any number of workers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from clbvh import Mesh, build, validate_tree
from clbvh.builders.options import DEFAULT_QUALITY, FAST_QUALITY, MAX_DEPTH

from ..profiles import examples
from ..rays import mesh_as_on_device
from ..soup import make_soup

WORKERS = (1, 2, 5)
THRESHOLDS = (1, 7, 64, 10**6)

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

OPTIONS = st.fixed_dictionaries(
    {
        "bins": st.sampled_from([2, 3, 8, 16, 64]),
        "leaf_size": st.sampled_from([1, 2, 4, 8, 255]),
        "traversal_cost": st.sampled_from([0.01, 1.0, 8.0]),
    }
)


def assert_right(bvh, options):
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=options["leaf_size"])
    starts = set(bvh.nodes["first"][bvh.nodes["count"] > 0].tolist())
    descents = np.flatnonzero(np.diff(bvh.prim_ids) < 0) + 1
    assert starts.issuperset(descents.tolist()), "the primitives of a leaf must ascend"


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@examples(short=150, long=2000)
@given(mesh=st.one_of(SOUPS, HAND_PICKED), options=OPTIONS)
def test_a_tree_is_right(mesh, options, quality):
    assert_right(build(mesh, quality=quality, **options), options)


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@examples(short=30, long=300)
@given(mesh=st.one_of(SOUPS, HAND_PICKED), options=OPTIONS)
@example(mesh=make_soup(3000, seed=1), options={"bins": 16, "leaf_size": 4, "traversal_cost": 1.0})
@example(mesh=make_soup(1, seed=1), options={"bins": 16, "leaf_size": 4, "traversal_cost": 1.0})
def test_the_bytes_do_not_depend_on_workers_nor_thresholds(mesh, options, quality, pools):
    serial = build(mesh, quality=quality, **options)
    assert_right(serial, options)
    for workers in WORKERS:
        for threshold in THRESHOLDS:
            parallel = build(mesh, pool=pools[workers], task_threshold=threshold, quality=quality, **options)
            who = f"{workers} workers, threshold {threshold}"
            assert parallel.nodes.tobytes() == serial.nodes.tobytes(), who
            assert parallel.prim_ids.tobytes() == serial.prim_ids.tobytes(), who


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@examples(short=30, long=300)
@given(mesh=SOUPS, options=OPTIONS)
def test_a_second_build_gives_the_same_bytes(mesh, options, quality):
    first, second = build(mesh, quality=quality, **options), build(mesh, quality=quality, **options)
    assert first.nodes.tobytes() == second.nodes.tobytes()
    assert first.prim_ids.tobytes() == second.prim_ids.tobytes()


@pytest.mark.parametrize("quality", [FAST_QUALITY, DEFAULT_QUALITY])
@examples(short=50, long=500)
@given(mesh=SOUPS, shift=st.sampled_from([-3, 1, 6]))
def test_a_power_of_two_as_unit_of_length_does_not_matter(mesh, shift, quality):
    """Scaling by it is exact, so every comparison comes out the same."""
    scale = np.float32(2.0**shift)
    scaled = mesh_as_on_device(mesh.local_vertices * scale, mesh.faces)
    before, after = build(mesh, quality=quality), build(scaled, quality=quality)
    assert before.prim_ids.tobytes() == after.prim_ids.tobytes()
    for field in ("aabb_min", "aabb_max"):
        assert (before.nodes[field] * scale == after.nodes[field]).all()

"""Any mesh, any options, quality `high`: a right tree, never costlier, and the same bytes for any number of workers."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from clbvh import build, make_shape, sah_cost

from ..profiles import examples
from ..soup import make_soup
from .test_builds import HAND_PICKED, OPTIONS, SOUPS, assert_right


@examples(short=40, long=1000)
@given(mesh=st.one_of(SOUPS, HAND_PICKED), options=OPTIONS)
def test_a_tree_is_right_and_never_costlier(mesh, options):
    for chosen in (options, {key: value for key, value in options.items() if key != "bins"}):
        plain, high = build(mesh, **chosen), build(mesh, quality="high", **chosen)
        assert_right(high, options)
        cost = {"traversal_cost": options["traversal_cost"]}
        assert sah_cost(high, **cost) <= sah_cost(plain, **cost)


@examples(short=15, long=200)
@given(mesh=SOUPS, options=OPTIONS)
def test_the_bytes_do_not_depend_on_workers(mesh, options, pools):
    alone = build(mesh, quality="high", **options)
    for workers, pool in pools.items():
        shared = build(mesh, pool=pool, quality="high", task_threshold=64, **options)
        assert shared.nodes.tobytes() == alone.nodes.tobytes(), workers
        assert shared.prim_ids.tobytes() == alone.prim_ids.tobytes(), workers


@pytest.mark.parametrize("seed", [1])
@pytest.mark.parametrize("name", ["palace", "boxes"])
def test_threads_that_share_a_large_tree_give_the_same_bytes(name, seed, pools):
    mesh = make_shape(name, triangles=60_000, seed=seed)  # eight parts and more
    alone = build(mesh, quality="high")
    assert_right(alone, {"leaf_size": 4})
    for workers, pool in pools.items():
        shared = build(mesh, pool=pool, quality="high")
        assert shared.nodes.tobytes() == alone.nodes.tobytes(), workers
        assert shared.prim_ids.tobytes() == alone.prim_ids.tobytes(), workers


@pytest.mark.parametrize("count", [20_000])
def test_triangles_that_all_overlap_take_no_quadratic_time(count, pools):
    """A search that visits the whole tree from every node takes 4e8 steps each way, and minutes."""
    mesh = make_soup(count, 3, grid=20, size=1000)
    assert_right(build(mesh, quality="high"), {"leaf_size": 4})

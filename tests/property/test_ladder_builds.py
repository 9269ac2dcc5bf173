"""Any mesh, any options, any variant of the ladder: a right tree, and the same bytes for any number of workers."""

from __future__ import annotations

import dataclasses

from hypothesis import example, given, strategies as st

from clbvh import BuildOptions, validate_tree
from clbvh.builders.build import build_tree
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.builders.options import MAX_DEPTH

from ..profiles import examples
from ..soup import make_soup
from .test_builds import HAND_PICKED, SOUPS, WORKERS

OPTIONS = st.builds(
    BuildOptions,
    bins=st.sampled_from([2, 3, 8, 64]),
    leaf_size=st.sampled_from([1, 2, 4, 255]),
    frontier=st.sampled_from([4, 5, 64, 8192]),
)
NAMES = st.sampled_from(list(VARIANTS))
THRESHOLDS = (1, 30, 10**6)

# Variants that look for the same split, by different ways.
SAME_TREE = (("sequential", "naive", "range", "cached", "median"), ("bin", "atomic", "flatten", "flat"))


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


@examples(short=30, long=1000)
@given(mesh=st.one_of(SOUPS, HAND_PICKED), options=OPTIONS)
def test_variants_that_share_a_split_make_the_same_right_tree(mesh, options):
    for names in SAME_TREE:
        trees = [build_tree(mesh, name, None, options) for name in names]
        validate_tree(trees[0], max_depth=MAX_DEPTH, max_leaf_size=options.leaf_size)
        assert len({bytes_of(tree) for tree in trees}) == 1
    frontier = build_tree(mesh, "frontier", None, options)
    validate_tree(frontier, max_depth=MAX_DEPTH, max_leaf_size=options.frontier)


@examples(short=12, long=400)
@given(mesh=st.one_of(SOUPS, HAND_PICKED), options=OPTIONS, name=NAMES)
@example(mesh=make_soup(3000, seed=1), options=BuildOptions(leaf_size=1), name="atomic")
@example(mesh=make_soup(3000, seed=1), options=BuildOptions(leaf_size=1), name="naive")
def test_the_bytes_do_not_depend_on_workers_nor_thresholds(mesh, options, name, pools):
    serial = build_tree(mesh, name, None, options)
    for workers in WORKERS:
        for threshold in THRESHOLDS:
            cut = dataclasses.replace(options, task_threshold=threshold)
            in_processes = build_tree(mesh, name, pools[workers], cut)
            in_threads = build_tree(mesh, name, None, cut, workers)
            assert bytes_of(in_processes) == bytes_of(in_threads) == bytes_of(serial), f"{workers} workers, {threshold}"

"""The report's ladder: each variant does what its name says, and all that share an idea make the same tree."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from clbvh import SubtreePool, build
from clbvh.builders.executor import ThreadExecutor
from clbvh.builders.ladder import steps
from clbvh.builders.ladder.steps import COUNTER_WORDS, LINKED_NODE
from clbvh.builders.processes.pool import open_executor

from ...soup import make_soup
from .reference import build_ladder, cut_between_bins, halve_by_median
from .shapes import MESHES

MEDIANS = ["sequential", "naive", "range", "cached", "median"]
BINS = ["bin", "atomic", "flatten", "flat"]
# Not too deep for recursion.
SHALLOW = ["9", "soup", "on a grid", "nested", "1e38", "signed zeros"]


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


def test_variants_build_the_tree_of_medians_or_that_of_bins():
    for mesh_name in SHALLOW:
        mesh = MESHES[mesh_name]()
        for names, divide, leaf_size, bins in (
            (MEDIANS, halve_by_median, 1, None),
            (MEDIANS, halve_by_median, 4, None),
            (BINS, cut_between_bins, 1, None),
            (BINS, cut_between_bins, 4, 2),
            (BINS, cut_between_bins, 4, 64),
        ):
            nodes, prim_ids = build_ladder(mesh, divide, leaf_size, bins or 8)
            for name in names:
                bvh = build(mesh, builder=name, leaf_size=leaf_size, bins=bins)
                assert bytes_of(bvh) == (nodes.tobytes(), prim_ids.tobytes()), (mesh_name, name)


def test_the_frontier_is_the_size_of_the_leaves(mesh):
    for frontier in (4, 100):
        stopped = build(mesh, builder="frontier", leaf_size=1, frontier=frontier)
        assert bytes_of(stopped) == bytes_of(build(mesh, builder="flat", leaf_size=frontier))


# One of two workers may be done before the other begins, on a busy machine.
ROUNDS = 20


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_workers_that_count_together_lose_no_number(kind, pool):
    count, end = 2_000_000, 2
    with ThreadExecutor(2) if kind == "threads" else open_executor(pool) as executor:
        executor.create("blocks", (1,), LINKED_NODE)
        counter = executor.create("counter", (COUNTER_WORDS,), np.int64)
        counter[:] = 0
        executor.map(steps.allocate_blocks, [(1,)] * 2)  # the library is loaded
        for _ in range(ROUNDS):
            references = np.array(executor.map(steps.allocate_blocks, [(count,)] * 2))
            begin, end = end, end + 2 * count
            assert counter.tolist() == [end] + [0] * (COUNTER_WORDS - 1)
            assert (np.sort(references, axis=None) == np.arange(begin, end) * LINKED_NODE.itemsize).all()
            # Each of them got numbers from between the other's: both counted at the same time.
            if (np.diff(references) > LINKED_NODE.itemsize).any(axis=1).all():
                break
        else:
            pytest.fail(f"in {ROUNDS} rounds the workers never counted at the same time")


def count_held(arrays):
    return len(steps._held)


def test_no_linked_nodes_are_kept_and_builds_of_several_threads_leave_each_others_alone(pool):
    meshes = [make_soup(500, seed=seed) for seed in range(8)]
    with ThreadPoolExecutor(4) as others:
        trees = list(others.map(lambda mesh: build(mesh, builder="flatten", task_threshold=20), meshes))
    trees[0] = build(meshes[0], pool=pool, builder="flatten", task_threshold=20)
    for mesh, tree in zip(meshes, trees, strict=True):
        assert bytes_of(tree) == bytes_of(build(mesh, builder="flat"))
    with open_executor(pool) as executor:
        assert [count_held({}), *executor.run_on_each(count_held)] == [0, 0, 0]

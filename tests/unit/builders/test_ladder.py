"""The report's ladder: each variant does what its name says, and all that share an idea make the same tree."""

from __future__ import annotations

import dataclasses
import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numba import njit

from clbvh import BuildOptions, Mesh, SubtreePool, make_shape, sah_cost, validate_tree
from clbvh.builders import build as build_module
from clbvh.builders.build import build_tree
from clbvh.builders.executor import ThreadExecutor
from clbvh.builders.ladder import divide as order, steps
from clbvh.builders.ladder.build_variant import DEFAULT_BINS
from clbvh.builders.ladder.divide import Cached, Recomputed, fill_cache, select, sort_range
from clbvh.builders.ladder.subtrees import (
    COUNTER_WORDS,
    NODE_BYTES,
    WORDS,
    Heap,
    allocate_node,
    build_linked,
    build_rows,
)
from clbvh.builders.ladder.variants import BINS, SELECT, VARIANTS, Nodes
from clbvh.builders.options import MAX_DEPTH
from clbvh.builders.processes.pool import open_executor

from ...rays import mesh_as_on_device
from ...soup import make_soup
from .reference_ladder import build_by_reference, cut_between_bins, halve_by_median

NAMES = ["sequential", "naive", "range", "cached", "median", "bin", "atomic", "flatten", "flat", "frontier"]
MEDIAN_NAMES = NAMES[:5]
BIN_NAMES = NAMES[5:9]
LINEAR_NAMES = NAMES[2:]

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


def build_by(name, mesh, pool, options):
    return build_tree(mesh, name, pool, options)


def from_corners(corners):
    """Return the mesh of (n, 3, 3) corners."""
    corners = np.asarray(corners, float)
    return Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def make_exponential(ratio):
    """Return triangles on three axes, each `ratio` times as far away as the one before: bins cut few off at a time."""
    distances = 1e-32 * ratio ** np.arange(int(math.log(1e66, ratio)))
    corners = np.zeros((len(distances), 3, 3))
    number = np.arange(len(distances))
    corners[number, :, number % 3] = distances[:, None]
    corners += distances[:, None, None] * 1e-3 * np.eye(3)
    return from_corners(np.concatenate([corners, -corners]))


def bytes_of(bvh):
    return bvh.nodes.tobytes(), bvh.prim_ids.tobytes()


MESHES = {
    "one": lambda: make_soup(1, seed=1),
    "two": lambda: make_soup(2, seed=1),
    "three": lambda: make_soup(3, seed=1),
    "nine": lambda: make_soup(9, seed=1),
    "soup": lambda: make_soup(700, seed=2, copies=0.3, degenerate=0.1),
    "on a grid": lambda: make_soup(500, seed=3, grid=3, size=1),
    "equal centroids": lambda: from_corners(
        np.arange(1, 401)[:, None, None] * np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1]])
    ),
    "copies": lambda: from_corners(np.tile(TRIANGLE, (2000, 1, 1))),
    "scales of 1.5": lambda: make_exponential(1.5),
    "below normal numbers": lambda: make_soup(300, seed=6, scale=1e-43),
    "1e38": lambda: make_soup(300, seed=6, scale=1.6e35),
    "as wide as float32": lambda: make_soup(300, seed=6, grid=1000, size=0, scale=6.7e35),
}


def test_the_ladder_has_the_variants_of_the_report_in_its_order():
    assert list(VARIANTS) == NAMES
    assert [name for name, variant in VARIANTS.items() if variant.name != name] == []
    assert DEFAULT_BINS == 8


@pytest.mark.parametrize(
    ("name", "before", "change"),
    [
        ("naive", "sequential", {"parallel": True}),
        ("range", "naive", {"copies": False}),
        ("cached", "range", {"cached": True}),
        ("median", "cached", {"how": SELECT}),
        ("bin", "median", {"how": BINS}),
        ("atomic", "bin", {"nodes": Nodes.COUNTER}),
        ("flatten", "bin", {"flattens": True}),
        ("flat", "bin", {"nodes": Nodes.ROWS}),
        ("frontier", "flat", {"frontier": True}),
    ],
)
def test_a_variant_changes_one_thing(name, before, change):
    now, then = dataclasses.asdict(VARIANTS[name]), dataclasses.asdict(VARIANTS[before])
    assert {field: now[field] for field in now if field != "name" and now[field] != then[field]} == change


@pytest.mark.parametrize("mesh_name", MESHES)
@pytest.mark.parametrize("name", NAMES)
def test_every_variant_gives_a_right_tree_whoever_builds_it(name, mesh_name, pool):
    mesh = MESHES[mesh_name]()
    options = BuildOptions(bins=8, leaf_size=2, frontier=16)
    bvh = build_by(name, mesh, None, options)
    validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=16 if name == "frontier" else 2)
    for threshold in (None, 1, 60):
        parallel = build_by(name, mesh, pool, dataclasses.replace(options, task_threshold=threshold))
        assert bytes_of(parallel) == bytes_of(bvh), f"threshold {threshold}"


@pytest.mark.parametrize("mesh_name", ["nine", "soup", "on a grid", "equal centroids", "1e38"])
@pytest.mark.parametrize("leaf_size", [1, 4])
def test_the_first_five_variants_build_the_tree_of_medians(mesh_name, leaf_size):
    mesh = MESHES[mesh_name]()
    nodes, prim_ids = build_by_reference(mesh, halve_by_median, leaf_size)
    for name in MEDIAN_NAMES:
        assert bytes_of(build_by(name, mesh, None, BuildOptions(leaf_size=leaf_size))) == (
            nodes.tobytes(), prim_ids.tobytes()
        ), name  # fmt: skip


@pytest.mark.parametrize("mesh_name", ["nine", "soup", "on a grid", "equal centroids", "1e38"])
@pytest.mark.parametrize(("leaf_size", "bins"), [(1, 8), (4, 2), (4, 64)])
def test_the_others_build_the_tree_of_bins(mesh_name, leaf_size, bins):
    mesh = MESHES[mesh_name]()
    nodes, prim_ids = build_by_reference(mesh, cut_between_bins, leaf_size, bins)
    for name in BIN_NAMES:
        assert bytes_of(build_by(name, mesh, None, BuildOptions(bins, leaf_size))) == (
            nodes.tobytes(), prim_ids.tobytes()
        ), name  # fmt: skip


def test_no_box_holds_a_negative_zero():
    """Which of two zeros a minimum gives depends on their order, and the order on the way to the split."""
    random = np.random.default_rng(8)
    vertices = random.choice(np.array([-1, -0.0, 0.0, 1], np.float32), (300, 3))
    mesh = mesh_as_on_device(vertices, np.arange(300).reshape(-1, 3))
    for names in (MEDIAN_NAMES, BIN_NAMES):
        trees = [build_by(name, mesh, None, BuildOptions(bins=3)) for name in names]
        assert len({bytes_of(tree) for tree in trees}) == 1
        for field in ("aabb_min", "aabb_max"):
            zeros = trees[0].nodes[field][trees[0].nodes[field] == 0]
            assert len(zeros) > 10
            assert not np.signbit(zeros).any()


def test_the_frontier_is_the_size_of_the_leaves():
    mesh = make_soup(3000, seed=4)
    for frontier in (4, 100):
        stopped = build_by("frontier", mesh, None, BuildOptions(leaf_size=1, frontier=frontier))
        assert bytes_of(stopped) == bytes_of(build_by("flat", mesh, None, BuildOptions(leaf_size=frontier)))
    whole = build_by("frontier", mesh, None, BuildOptions(frontier=8192))
    assert whole.node_count == 1
    assert whole.prim_ids.tolist() == list(range(3000))


def test_bins_make_a_tree_nearly_as_good_as_the_median():
    mesh = make_shape("knot", triangles=5000, seed=1)
    costs = {name: sah_cost(build_by(name, mesh, None, BuildOptions(bins=8))) for name in ("median", "bin")}
    assert costs["bin"] < 1.1 * costs["median"]


def test_the_depth_limit_is_reached_and_kept():
    bvh = build_by("bin", make_exponential(1.5), None, BuildOptions(bins=2, leaf_size=1))
    assert bvh.depth == MAX_DEPTH
    assert build_by("median", make_exponential(1.5), None, BuildOptions(leaf_size=1)).depth < 12


@pytest.mark.parametrize(
    ("name", "phases"),
    [
        ("sequential", ["share", "top", "subtrees", "convert"]),
        ("range", ["share", "top", "subtrees", "convert"]),
        ("cached", ["share", "metadata", "top", "subtrees", "convert"]),
        ("atomic", ["share", "metadata", "top", "subtrees", "convert"]),
        ("flatten", ["share", "metadata", "top", "subtrees", "flatten"]),
        ("flat", ["share", "metadata", "top", "subtrees", "compact"]),
    ],
)
def test_each_phase_is_timed(name, phases, pool):
    mesh = make_soup(5000, seed=5)
    for who in (None, pool):
        begin = time.perf_counter()
        bvh = build_by(name, mesh, who, BuildOptions())
        wall_ms = 1e3 * (time.perf_counter() - begin)
        assert list(bvh.timings_ms) == phases
        assert all(lap > 0 for lap in bvh.timings_ms.values())
        assert bvh.timings_ms["subtrees"] < sum(bvh.timings_ms.values()) <= wall_ms


@pytest.mark.parametrize("name", NAMES)
def test_the_mesh_is_not_changed_and_may_be_one_that_nobody_may_write_to(name):
    mesh = make_soup(300, seed=5)
    build_by(name, mesh, None, BuildOptions())
    compiled = [len(function.signatures) for function in (build_linked, build_rows, fill_cache)]
    before = mesh.local_vertices.tobytes(), mesh.faces.tobytes()
    mesh.local_vertices.flags.writeable = mesh.faces.flags.writeable = False
    bvh = build_by(name, mesh, None, BuildOptions())
    assert bvh.mesh is mesh
    assert compiled == [len(function.signatures) for function in (build_linked, build_rows, fill_cache)]
    assert (mesh.local_vertices.tobytes(), mesh.faces.tobytes()) == before


class Untouchable:
    """A pool that fails when it is used."""

    def __getattr__(self, name):
        raise AssertionError(f"pool.{name} was used")


def test_only_the_first_variant_leaves_the_workers_alone():
    mesh = make_soup(100, seed=5)
    build_by("sequential", mesh, Untouchable(), BuildOptions())
    for name in NAMES[1:]:
        with pytest.raises(AssertionError, match="was used"):
            build_by(name, mesh, Untouchable(), BuildOptions())


@pytest.mark.parametrize("name", LINEAR_NAMES)
def test_no_mesh_takes_quadratic_time(name):
    count = 50_000
    meshes = [
        from_corners(np.broadcast_to(TRIANGLE, (count, 3, 3))),
        from_corners(np.arange(1, count + 1)[:, None, None] * np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1]])),
    ]
    build_by(name, make_soup(10, seed=1), None, BuildOptions())  # the compiled code is loaded
    for mesh in meshes:
        begin = time.process_time()
        bvh = build_by(name, mesh, None, BuildOptions(leaf_size=1, frontier=8192))
        # 0.4 s at most on a 2-core x86-64 server; 2.5e9 steps would take longer than this.
        assert time.process_time() - begin < 3
        assert bvh.depth == math.ceil(math.log2(count)) or name == "frontier"


def make_prims(values):
    """Return primitives with these coordinates along axis 0, cached and as a mesh of points."""
    points = np.zeros((len(values), 3), np.float32)
    points[:, 0] = values
    faces = np.repeat(np.arange(len(values), dtype=np.int32)[:, None], 3, axis=1)
    return Cached(np.hstack([points, points]), points), Recomputed(points, faces)


ORDERS = {
    "ascending": np.arange(1000),
    "descending": -np.arange(1000),
    "equal": np.zeros(1000),
    "two values": np.arange(1000) % 2,
    "up and down": -np.abs(np.arange(1000) - 500),
    "random": np.random.default_rng(1).random(1000),
}


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("middle", [3, 4, 500, 989])
def test_a_selection_is_a_sort_at_the_middle(name, middle):
    begin, end, values = 3, 990, ORDERS[name]
    for prims in make_prims(values):
        for ids in (np.arange(1000, dtype=np.int32), np.random.default_rng(2).permutation(1000).astype(np.int32)):
            expected = ids.copy()
            expected[begin:end] = sorted(ids[begin:end], key=lambda prim: (values[prim], prim))
            changed, scratch = ids.copy(), np.empty(end - begin, np.int32)
            select(prims, changed, begin, end, middle, 0, scratch)
            assert set(changed[begin:middle]) == set(expected[begin:middle])
            assert sorted(changed[begin:end]) == sorted(expected[begin:end])
            sort_range(prims, ids, begin, end, 0, scratch)
            assert ids.tolist() == expected.tolist()
            assert changed[:begin].tolist() == expected[:begin].tolist()
            assert changed[end:].tolist() == expected[end:].tolist()


def test_the_worst_input_of_all_ends_a_selection_by_a_sort(monkeypatch):
    """An adversary makes up the values while they are compared (McIlroy, "A killer adversary for quicksort", 1999)."""
    count = 2000
    values, solid, candidate, comparisons, sorted_ranges = [math.inf] * count, 0, -1, 0, []

    def compare(prims, one, other, axis):
        nonlocal solid, candidate, comparisons
        comparisons += 1
        if one != other and values[one] == values[other] == math.inf:
            frozen = one if one == candidate else other
            values[frozen] = solid
            solid += 1
        if values[one] == math.inf:
            candidate = one
        elif values[other] == math.inf:
            candidate = other
        return values[one] < values[other] or (values[one] == values[other] and one < other)

    monkeypatch.setattr(order, "comes_before", compare)
    monkeypatch.setattr(order, "sort_range", lambda prims, ids, begin, end, axis, scratch: sorted_ranges.append(end))
    select.py_func(None, list(range(count)), 0, count, count // 2, 0, None)
    assert len(sorted_ranges) == 1
    assert comparisons < 3 * count * math.log2(count)


@njit(cache=True, nogil=True)
def _allocate_many(heap, references):
    for index in range(len(references)):
        references[index] = allocate_node(heap)


def allocate_many(arrays, count):
    references = np.empty(count, np.int64)
    _allocate_many(Heap(arrays["blocks"], arrays["counter"]), references)
    return references


# One of two workers may be done before the other begins, on a busy machine.
ROUNDS = 20


@pytest.fixture(params=["threads", "processes"])
def executor(request, pool):
    with open_executor(pool) if request.param == "processes" else ThreadExecutor(2) as executor:
        yield executor


def test_workers_that_count_together_lose_no_number(executor):
    count = 2_000_000
    executor.create("blocks", (1, WORDS), np.int64)
    counter = executor.create("counter", (COUNTER_WORDS,), np.int64)
    counter[:] = 0
    executor.map(allocate_many, [(1,)] * 2)  # the compiled code is loaded
    end = 2
    for _ in range(ROUNDS):
        references = np.array(executor.map(allocate_many, [(count,)] * 2))
        begin, end = end, end + 2 * count
        assert counter.tolist() == [end] + [0] * (COUNTER_WORDS - 1)
        assert (np.sort(references, axis=None) == np.arange(begin, end) * NODE_BYTES).all()
        # Each of them got numbers from between the other's: both counted at the same time.
        if (np.diff(references) > NODE_BYTES).any(axis=1).all():
            break
    else:
        pytest.fail(f"in {ROUNDS} rounds the workers never counted at the same time")


def test_every_node_of_the_atomic_variant_is_counted(monkeypatch, pool):
    counted = []
    link = steps.link_counted

    class Spy(ThreadExecutor):
        def map(self, step, tasks):
            results = super().map(step, tasks)
            if step is link:
                counted.append((self.arrays["counter"].copy(), results))
            return results

    build_by("atomic", make_soup(10, seed=1), None, BuildOptions())
    monkeypatch.setattr(build_module, "ThreadExecutor", Spy)
    bvh = build_by("atomic", make_soup(1000, seed=1), None, BuildOptions(task_threshold=50))
    ((counter, (node_count,)),) = counted
    assert counter[0] == node_count == bvh.node_count


def count_held(arrays):
    return len(steps._held)


def test_workers_keep_no_linked_nodes_after_a_build(pool):
    mesh = make_soup(500, seed=7)
    first = build_by("flatten", mesh, pool, BuildOptions(task_threshold=20))
    with open_executor(pool) as executor:
        assert executor.run_on_each(count_held) == [0, 0]
    assert bytes_of(first) == bytes_of(build_by("flatten", mesh, None, BuildOptions()))
    assert count_held({}) == 0


def test_builds_of_several_threads_leave_each_others_linked_nodes_alone():
    meshes = [make_soup(500, seed=seed) for seed in range(8)]
    with ThreadPoolExecutor(4) as others:
        trees = list(others.map(lambda mesh: build_by("flatten", mesh, None, BuildOptions(task_threshold=20)), meshes))
    for mesh, tree in zip(meshes, trees, strict=True):
        assert bytes_of(tree) == bytes_of(build_by("flat", mesh, None, BuildOptions()))
    assert count_held({}) == 0

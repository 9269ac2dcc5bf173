"""Trees built on a device: in the order of the curve, merged as defined, the same bytes however the work is shared."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
import pytest

from clbvh import BuildOptions, ConfigError, DeviceError, Mesh, Spheres, build, make_shape, sah_cost, validate_tree
from clbvh.builders.build import build_shape, suit_options
from clbvh.builders.device import build_device
from clbvh.builders.device.build_device import ROWS, TreeForm, build_tree_on
from clbvh.builders.device.passes import CLUSTERS_LEFT, TILE_SIZE, plan_passes
from clbvh.device.radix_sort import CPU_PLAN, GPU_PLAN, SortPlan, sort_pairs
from clbvh.layouts.device_prims import DevicePrims
from clbvh.tree_layouts import LAYOUTS

from ...soup import make_soup
from ...worlds import arrays_of
from .shapes import SHAPES, copies, nested

pytestmark = pytest.mark.on_both

FAST = BuildOptions(quality="fast")
DEVICE_LAYOUTS = ("bvh2", "bvh4", "bvh8")
FORMS = [ROWS, *(TreeForm(LAYOUTS[layout]) for layout in DEVICE_LAYOUTS)]


@pytest.fixture
def grouped(session):
    """A session that has a work-group for each tile, as on GPUs."""
    with session.branch() as branch:
        branch.info = dataclasses.replace(session.info, kind="gpu")
        yield branch


def build_on(session, shape, form, options=FAST):
    """Return the nodes and the primitives that a device builds, and the tree."""
    tree = build_tree_on(session, DevicePrims(session, session, shape), options, form)
    nodes, prims = np.empty(tree.node_count, form.node), np.empty(tree.block_count * form.layout.block_width, np.int32)
    session.download(tree.nodes, nodes)
    session.download(tree.prims, prims)
    return nodes, prims, tree


def bytes_of(built):
    nodes, prims, tree = built
    return nodes.tobytes(), prims.tobytes(), tree.stack_size, tree.lower.tobytes(), tree.upper.tobytes()


def make_shapes():
    yield from (make() for make in SHAPES.values())
    for count in (TILE_SIZE - 1, TILE_SIZE, TILE_SIZE + 1, 2 * TILE_SIZE + 1, 20_000):
        yield make_soup(count, count, grid=30, size=4, copies=0.2, degenerate=0.2)


def test_the_arrays_of_a_layout_are_those_that_the_host_makes_of_the_tree(session):
    for shape in make_shapes():
        bvh = build_shape(shape, "fast", session.info)
        validate_tree(bvh, max_depth=64, max_leaf_size=FAST.leaf_size)
        for layout in DEVICE_LAYOUTS:
            expected, form = arrays_of(bvh, layout), TreeForm(LAYOUTS[layout])
            prims = DevicePrims(session, session, shape)
            tree = build_tree_on(session, prims, suit_options(shape, "fast"), form)
            blocks = prims.make_blocks(session, form.layout.block_width, tree.prims, tree.block_count)
            for buffer, array in ((tree.nodes, expected.nodes), (blocks, expected.blocks)):
                found = np.empty_like(array)
                session.download(buffer, found)
                assert found.tobytes() == array.tobytes()
            assert tree.stack_size == expected.stack_size


@pytest.mark.on_opencl
def test_a_work_group_merges_the_clusters_of_a_tile_as_one_item_does(session, grouped):
    for shape in make_shapes():
        for form in FORMS:
            assert bytes_of(build_on(grouped, shape, form)) == bytes_of(build_on(session, shape, form))


def test_pairs_are_sorted_by_their_keys_and_equal_ones_stay_in_order(session):
    generator = np.random.default_rng(4)
    # The host has code for one plan.
    plans = [CPU_PLAN] if session.info.is_host else [CPU_PLAN, GPU_PLAN, SortPlan(3, 4, 5), SortPlan(11, 1, 7)]
    for count, plan in product((1, 2, 19, 20, 21, 2048, 5000), plans):
        for most in (1, 3, 1 << 30):
            pairs = generator.integers(0, most, count, np.uint64) << np.uint64(32) | np.arange(count, dtype=np.uint64)
            found = np.empty_like(pairs)
            session.download(sort_pairs(session, session.upload(pairs), count, 30, plan), found)
            assert (found == np.sort(pairs)).all()


def find_codes(boxes, bits):
    """Return the Morton codes of the centroids of boxes, from -1 to 1; bits are those of each axis."""
    cells = np.clip((boxes.sum(axis=1).astype(np.float64) + 2) * 2.0 ** (bits - 2), 0, 2**bits - 1).astype(np.uint64)
    codes = np.zeros(len(boxes), np.uint64)
    for bit in range(bits):
        for axis in range(3):
            codes |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + 2 - axis)
    return codes


def box_corners(shape):
    points, ids = shape.find_corners()
    corners = points[ids] + np.float32(0)
    return np.stack((corners.min(axis=1), corners.max(axis=1)), axis=1)


def merge_by_definition(boxes, radius=4):
    """Return the children of each merge of one tile: the numbers of merges, or ~i for primitive i."""
    clusters = [(~i, *box) for i, box in enumerate(boxes)]
    merges = []

    def distance(one, other):
        size = np.maximum(clusters[one][2], clusters[other][2]) - np.minimum(clusters[one][1], clusters[other][1])
        area = np.float32(2.0**-100) + size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
        return int(area.view(np.int32)) & ~15 | (one ^ other) & 15

    while len(clusters) > 1:
        count = len(clusters)
        partners = [
            min(
                (other for other in range(max(0, i - radius), min(count, i + radius + 1)) if other != i),
                key=lambda other, i=i: distance(i, other),
            )
            for i in range(count)
        ]
        left_over = []
        for i, partner in enumerate(partners):
            if partners[partner] != i:
                left_over.append(clusters[i])
            elif i < partner:
                (one, lower, upper), (other, other_lower, other_upper) = clusters[i], clusters[partner]
                left_over.append((len(merges), np.minimum(lower, other_lower), np.maximum(upper, other_upper)))
                merges.append((one, other))
        clusters = left_over
    return merges


def leaves_of(merges):
    """Return the depth of each primitive, from left to right."""
    found, stack = [], [(len(merges) - 1, 0)]
    while stack:
        cluster, depth = stack.pop()
        if cluster < 0:
            found.append((~cluster, depth))
        else:
            one, other = merges[cluster]
            stack += [(other, depth + 1), (one, depth + 1)]
    return found


def find_leaves(bvh):
    """Return the primitive and the depth of each leaf, in the order of `prim_ids`."""
    depths = np.zeros(len(bvh.nodes), int)
    for node in np.flatnonzero(bvh.nodes["count"] == 0):
        depths[bvh.nodes["first"][node] + np.arange(2)] = depths[node] + 1
    is_leaf = bvh.nodes["count"] > 0
    found = sorted(zip(bvh.nodes["first"][is_leaf], depths[is_leaf], strict=True))
    return [(bvh.prim_ids[first], depth) for first, depth in found]


@pytest.mark.parametrize("keys", [1, 2])
def test_nearest_neighbours_along_the_curve_are_merged(session, monkeypatch, keys):
    monkeypatch.setattr(build_device, "_MOST_FOR_ONE_KEY", 1 << 24 if keys == 1 else 0)
    for shape in (make_soup(TILE_SIZE, 1, size=20), make_soup(300, 2, grid=5, copies=0.3), copies(100)):
        boxes = box_corners(shape)
        order = np.argsort(find_codes(boxes, 10 * keys), kind="stable")
        expected = [(order[place], depth) for place, depth in leaves_of(merge_by_definition(boxes[order]))]
        bvh = build(shape, quality="fast", leaf_size=1)
        assert find_leaves(bvh) == expected


def test_each_tile_leaves_as_many_clusters_as_the_plan_says():
    for count in (1, 2, 511, 512, 513, 1_000_000, 2**30):
        passes = plan_passes(count)
        merges, clusters = 0, count
        for number, each in enumerate(passes):
            assert (each.cluster_count, each.first_merge) == (clusters, merges)
            assert -(-clusters // each.tile_count) <= TILE_SIZE
            is_last = number == len(passes) - 1
            assert (each.tile_count == 1) == is_last
            assert each.target == (1 if is_last else CLUSTERS_LEFT)
            # No tile has fewer clusters than it leaves.
            assert clusters // each.tile_count >= each.target
            clusters = each.target * each.tile_count
            merges = count - clusters
        assert clusters == 1
        # Halving every tile stays below the depth limit.
        assert sum((-(-each.cluster_count // each.tile_count) - 1).bit_length() for each in passes) < 64


def test_leaf_size_and_cost_are_obeyed_and_the_default_leaves_suit_the_layout(session):
    mesh = make_shape("blobs", triangles=3000)
    for leaf_size in (1, 2, 30, 255):
        bvh = build(mesh, quality="fast", leaf_size=leaf_size, traversal_cost=30.0)
        most = bvh.nodes["count"].max()
        assert most == leaf_size if leaf_size < 3 else leaf_size // 4 < most <= leaf_size
        _, prims, tree = build_on(
            session, mesh, TreeForm(LAYOUTS["bvh8"]), BuildOptions(leaf_size=leaf_size, quality="fast")
        )
        assert len(prims) == 8 * tree.block_count
    assert sah_cost(build(mesh, quality="fast")) < sah_cost(build(mesh, quality="fast", leaf_size=1))


def test_a_deep_chain_is_paired_so_that_it_ends_above_the_limit():
    bvh = build(nested(20_000), quality="fast", leaf_size=1)
    assert bvh.depth <= 64
    validate_tree(bvh, max_depth=64, max_leaf_size=1)


def test_a_device_is_for_fast_trees_alone_and_where_there_is_none_the_host_is_named(monkeypatch):
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    with pytest.raises(ConfigError, match="only trees of quality 'fast' are built on a device: leave 'cpu' out"):
        build(mesh, device="cpu")
    with pytest.raises(DeviceError, match=r"no device matches 'none like this': the devices? .*\)$"):
        build(mesh, quality="fast", device="none like this")
    monkeypatch.setenv("CLBVH_DEVICE", "none like this")
    with pytest.raises(DeviceError, match="the quality 'default' is built without a device"):
        build(mesh, quality="fast")


@pytest.mark.on_opencl
def test_a_device_without_room_for_the_build_says_how_much_it_lacks(session):

    with session.branch() as branch:
        branch.info = dataclasses.replace(session.info, max_allocation_bytes=50_000)
        with pytest.raises(DeviceError, match=r"cannot hold a buffer of 0\.\d MB"):
            build_on(branch, make_shape("blobs", triangles=3000), TreeForm(LAYOUTS["bvh8"]))


def test_spheres_and_blocks_are_those_of_their_shape():
    spheres = Spheres(np.random.default_rng(1).normal(size=(500, 3)), 0.1)
    validate_tree(build_shape(spheres, "fast"), max_depth=64, max_leaf_size=4)
    assert spheres.kind.block(8).itemsize == 8 * 20

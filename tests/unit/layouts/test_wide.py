"""From two children to four and eight: the same triangles, in full groups, below boxes that are theirs."""

import numpy as np
import pytest

from clbvh import build
from clbvh.geometry import Mesh
from clbvh.geometry.shapes import make_shape
from clbvh.layout import GROUPS, NO_PRIM, WIDE_NODES
from clbvh.tree.wide import gather_groups, widen

from ..chain import make_chain
from ..soup import make_soup
from .hand_made import make_leaf

WIDTHS = list(WIDE_NODES)


def is_there(nodes):
    """Which children are there: those whose boxes are not inside out."""
    return (nodes["aabb_min"] <= nodes["aabb_max"]).all(axis=1)


def check_wide_tree(tree, bvh, width):
    """Every node and group once, every triangle once, boxes that are exact; return how many children can wait."""
    nodes, groups = tree.nodes, tree.groups
    assert nodes.dtype == WIDE_NODES[width]
    present = is_there(nodes)
    children = nodes["child"][present]
    assert sorted(children[children >= 0].tolist()) == list(range(1, len(nodes)))
    assert sorted((~children[children < 0]).tolist()) == list(range(len(groups)))
    prims = groups[groups != NO_PRIM]
    assert sorted(prims.tolist()) == list(range(bvh.mesh.face_count))
    # Present children and triangles come first.
    assert (np.diff(present.astype(int), axis=1) <= 0).all()
    assert (np.diff((groups != NO_PRIM).astype(int), axis=1) <= 0).all()
    absent = ~present[:, None, :].repeat(3, axis=1)
    assert (nodes["aabb_min"][absent] == np.finfo(np.float32).max).all()
    assert (nodes["aabb_max"][absent] == -np.finfo(np.float32).max).all()

    corners = bvh.mesh.vertices[bvh.mesh.faces]
    boxes, waiting = {}, {}
    for node in range(len(nodes) - 1, -1, -1):
        below = []
        for slot in np.flatnonzero(present[node]):
            child = nodes["child"][node, slot]
            if child >= 0:
                assert child > node
                box = boxes[child]
                below.append(waiting[child])
            else:
                inside = corners[[prim for prim in groups[~child] if prim != NO_PRIM]].reshape(-1, 3)
                box = (inside.min(axis=0), inside.max(axis=0))
            np.testing.assert_array_equal(nodes["aabb_min"][node, :, slot], box[0])
            np.testing.assert_array_equal(nodes["aabb_max"][node, :, slot], box[1])
        boxes[node] = (
            nodes["aabb_min"][node][:, present[node]].min(axis=1), nodes["aabb_max"][node][:, present[node]].max(axis=1)
        )  # fmt: skip
        waiting[node] = int(present[node].sum()) - 1 + max(below, default=0)
    assert tree.waiting == waiting[0]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("leaf_size", [1, 3, 4, 8, 9, 255])
@pytest.mark.parametrize("shape", ["knot", "blobs"])
def test_nothing_is_lost_and_nothing_is_there_twice(shape, leaf_size, width):
    bvh = build(make_shape(shape, triangles=2000), leaf_size=leaf_size, traversal_cost=1000 if leaf_size > 4 else 1)
    assert bvh.nodes["count"].max() > leaf_size // 2
    check_wide_tree(widen(bvh, width), bvh, width)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 17])
def test_small_meshes(count, width):
    mesh = make_soup(count, seed=count)
    for options in ({"leaf_size": 1}, {"leaf_size": 100, "traversal_cost": 1e6}):
        bvh = build(mesh, **options)
        tree = widen(bvh, width)
        check_wide_tree(tree, bvh, width)
        assert len(tree.groups) >= -(-count // width)


@pytest.mark.parametrize("width", WIDTHS)
def test_one_leaf_is_one_group(width):
    tree = widen(make_leaf(3), width)
    assert (len(tree.nodes), len(tree.groups), tree.waiting) == (1, 1, 0)
    assert tree.nodes["child"][0, 0] == ~0
    assert is_there(tree.nodes)[0].tolist() == [True] + [False] * (width - 1)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("leaf_side", ["left", "right"])
def test_a_deep_tree(leaf_side, width):
    _, bvh = make_chain(300, leaf_side)
    check_wide_tree(widen(bvh, width), bvh, width)


@pytest.mark.parametrize("shape", ["knot", "terrain", "blobs", "icosphere"])
@pytest.mark.parametrize("leaf_size", [1, 4, 8])
def test_groups_are_filled_whatever_the_leaf_size(shape, leaf_size):
    bvh = build(make_shape(shape, triangles=20_000), leaf_size=leaf_size)
    for width in WIDTHS:
        groups = widen(bvh, width).groups
        assert (groups != NO_PRIM).mean() > 0.62


def test_the_binary_tree_s_leaf_size_hardly_matters():
    mesh = make_shape("knot", triangles=20_000)
    sizes = [len(widen(build(mesh, leaf_size=leaf_size), 8).groups) for leaf_size in (1, 2, 4)]
    assert max(sizes) < 1.02 * min(sizes)


def test_no_other_choice_of_nodes_is_cheaper():
    """Against all ways to represent a small tree, tried one by one."""
    from clbvh.tree import wide

    bvh = build(make_shape("blobs", triangles=80), leaf_size=1)
    first, count = bvh.nodes["first"], bvh.nodes["count"]
    size = (bvh.nodes["aabb_max"] - bvh.nodes["aabb_min"]).astype(np.float64)
    areas = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
    price = wide.GROUP_PRICE * areas[0] / len(areas)
    for width in WIDTHS:

        def prims(row):
            return count[row] if count[row] else prims(first[row]) + prims(first[row] + 1)

        known = {}

        def cost(row, children, prims=prims, known=known, width=width):
            """The least cost of a subtree as at most so many children."""
            if (row, children) not in known:
                ways = []
                if prims(row) <= width:
                    ways.append(wide.GROUP_COST * areas[row] + price)
                if not count[row]:
                    left = first[row]
                    ways.append(areas[row] + min(cost(left, i) + cost(left + 1, width - i) for i in range(1, width)))
                    ways += [cost(left, i) + cost(left + 1, n - i) for n in range(2, children + 1) for i in range(1, n)]
                known[row, children] = min(ways)
            return known[row, children]

        tree = widen(bvh, width)
        obtained = areas[0]
        for node, present in zip(tree.nodes, is_there(tree.nodes), strict=True):
            for slot in np.flatnonzero(present):
                x, y, z = node["aabb_max"][:, slot].astype(np.float64) - node["aabb_min"][:, slot]
                is_leaf = node["child"][slot] < 0
                obtained += (x * y + y * z + z * x) * (wide.GROUP_COST if is_leaf else 1) + is_leaf * price
        assert obtained == pytest.approx(cost(0, 1), rel=1e-5)


@pytest.mark.parametrize("width", WIDTHS)
def test_groups_have_the_corners_of_their_triangles(width):
    corners = np.random.default_rng(70).uniform(-1, 1, (5, 3, 3))
    corners[2, 1] = corners[2, 0]
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(15).reshape(-1, 3))
    groups = np.full((2, width), NO_PRIM, np.int32)
    groups[0, :3], groups[1, :2] = [4, 2, 0], [1, 3]
    gathered = gather_groups(mesh, groups)
    assert gathered.dtype == GROUPS[width]
    np.testing.assert_array_equal(gathered["prim_id"], groups)
    for group, lane in np.ndindex(groups.shape):
        prim = groups[group, lane]
        found = gathered["corners"][group, :, :, lane]
        # No ray hits a lane without a triangle, or a degenerate triangle.
        if prim in (NO_PRIM, 2):
            assert np.isnan(found).all()
        else:
            np.testing.assert_array_equal(found, mesh.vertices[mesh.faces[prim]])

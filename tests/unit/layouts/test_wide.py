"""The wide layouts: the same triangles, in full blocks, below exact boxes."""

import numpy as np
import pytest

from clbvh import build
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.layouts.wide import widen
from clbvh.structs import NO_PRIM, WIDE_NODES

from ...chain import make_chain
from ...soup import make_soup
from ..hand_made import make_leaf

WIDTHS = list(WIDE_NODES)


def is_there(nodes):
    """Return which children exist: those whose boxes are not inverted."""
    return (nodes["aabb_min"] <= nodes["aabb_max"]).all(axis=1)


def check_wide_tree(tree, bvh, width):
    """Check: every node, block and triangle once, exact boxes, the stack size of a traversal."""
    nodes, blocks = tree.nodes, tree.blocks
    assert nodes.dtype == WIDE_NODES[width]
    present = is_there(nodes)
    children = nodes["child"][present]
    assert sorted(children[children >= 0].tolist()) == list(range(1, len(nodes)))
    assert sorted((~children[children < 0]).tolist()) == list(range(len(blocks)))
    prims = blocks[blocks != NO_PRIM]
    assert sorted(prims.tolist()) == list(range(bvh.mesh.face_count))
    # Present children and triangles come first.
    assert (np.diff(present.astype(int), axis=1) <= 0).all()
    assert (np.diff((blocks != NO_PRIM).astype(int), axis=1) <= 0).all()
    absent = ~present[:, None, :].repeat(3, axis=1)
    assert (nodes["aabb_min"][absent] == np.finfo(np.float32).max).all()
    assert (nodes["aabb_max"][absent] == -np.finfo(np.float32).max).all()

    corners = bvh.mesh.local_vertices[bvh.mesh.faces]
    boxes, stack_sizes = {}, {}
    for node in range(len(nodes) - 1, -1, -1):
        below = []
        for slot in np.flatnonzero(present[node]):
            child = nodes["child"][node, slot]
            if child >= 0:
                assert child > node
                box = boxes[child]
                below.append(stack_sizes[child])
            else:
                inside = corners[[prim for prim in blocks[~child] if prim != NO_PRIM]].reshape(-1, 3)
                box = (inside.min(axis=0), inside.max(axis=0))
            np.testing.assert_array_equal(nodes["aabb_min"][node, :, slot], box[0])
            np.testing.assert_array_equal(nodes["aabb_max"][node, :, slot], box[1])
        boxes[node] = (
            nodes["aabb_min"][node][:, present[node]].min(axis=1), nodes["aabb_max"][node][:, present[node]].max(axis=1)
        )  # fmt: skip
        stack_sizes[node] = int(present[node].sum()) - 1 + max(below, default=0)
    assert tree.stack_size == stack_sizes[0]


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
        assert len(tree.blocks) >= -(-count // width)


@pytest.mark.parametrize("width", WIDTHS)
def test_one_leaf_is_one_block(width):
    tree = widen(make_leaf(3), width)
    assert (len(tree.nodes), len(tree.blocks), tree.stack_size) == (1, 1, 0)
    assert tree.nodes["child"][0, 0] == ~0
    assert is_there(tree.nodes)[0].tolist() == [True] + [False] * (width - 1)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("leaf_side", ["left", "right"])
def test_a_deep_tree(leaf_side, width):
    _, bvh = make_chain(300, leaf_side)
    check_wide_tree(widen(bvh, width), bvh, width)


@pytest.mark.parametrize("shape", ["knot", "terrain", "blobs", "icosphere"])
@pytest.mark.parametrize("leaf_size", [1, 4, 8])
def test_blocks_are_filled_whatever_the_leaf_size(shape, leaf_size):
    bvh = build(make_shape(shape, triangles=20_000), leaf_size=leaf_size)
    for width in WIDTHS:
        blocks = widen(bvh, width).blocks
        assert (blocks != NO_PRIM).mean() > 0.62


def test_the_binary_tree_s_leaf_size_hardly_matters():
    mesh = make_shape("knot", triangles=20_000)
    sizes = [len(widen(build(mesh, leaf_size=leaf_size), 8).blocks) for leaf_size in (1, 2, 4)]
    assert max(sizes) < 1.02 * min(sizes)


def test_no_other_choice_of_nodes_is_cheaper():
    """Against all ways to represent a small tree, tried one by one."""
    from clbvh.layouts import wide as choose_children

    bvh = build(make_shape("blobs", triangles=80), leaf_size=1)
    first, count = bvh.nodes["first"], bvh.nodes["count"]
    size = (bvh.nodes["aabb_max"] - bvh.nodes["aabb_min"]).astype(np.float64)
    areas = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
    price = choose_children.BLOCK_PRICE * areas[0] / len(areas)
    for width in WIDTHS:

        def prims(node):
            return count[node] if count[node] else prims(first[node]) + prims(first[node] + 1)

        known = {}

        def cost(node, children, prims=prims, known=known, width=width):
            """Return the least cost of a subtree that becomes at most `children` children."""
            if (node, children) not in known:
                ways = []
                if prims(node) <= width:
                    ways.append(choose_children.BLOCK_COST * areas[node] + price)
                if not count[node]:
                    left = first[node]
                    ways.append(areas[node] + min(cost(left, i) + cost(left + 1, width - i) for i in range(1, width)))
                    ways += [cost(left, i) + cost(left + 1, n - i) for n in range(2, children + 1) for i in range(1, n)]
                known[node, children] = min(ways)
            return known[node, children]

        tree = widen(bvh, width)
        obtained = areas[0]
        for node, present in zip(tree.nodes, is_there(tree.nodes), strict=True):
            for slot in np.flatnonzero(present):
                x, y, z = node["aabb_max"][:, slot].astype(np.float64) - node["aabb_min"][:, slot]
                is_leaf = node["child"][slot] < 0
                obtained += (x * y + y * z + z * x) * (choose_children.BLOCK_COST if is_leaf else 1) + is_leaf * price
        assert obtained == pytest.approx(cost(0, 1), rel=1e-5)

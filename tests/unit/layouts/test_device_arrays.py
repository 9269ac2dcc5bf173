"""The arrays of every layout, by the host, built and refitted on the device: walked, with boxes found one by one."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, Spheres, build, make_shape, sah_cost
from clbvh.builders.build import build_tree
from clbvh.layouts import wide
from clbvh.layouts.device_arrays import has_shared_blocks
from clbvh.layouts.device_prims import DevicePrims
from clbvh.structs import NO_PRIM
from clbvh.support.host_threads import HostThreads
from clbvh.trace.world.refit import Refit
from clbvh.trace.world.trees import DeviceTrees, NewTree, RetiredBuffers
from clbvh.tree_layouts import LAYOUTS, SHARED_UNIT, TREE_LAYOUTS

from ...chain import make_chain
from ...soup import make_soup
from ...worlds import Arrays, arrays_of
from ..hand_made import make_leaf, make_tree

GREATEST = np.finfo(np.float32).max


def is_wide(layout):
    return LAYOUTS[layout].is_wide


def unpack(units, unit):
    """Return the faces and corners of a block of shared vertices, and the units to the next block of its leaf."""
    words = units["words"].reshape(-1)[4 * unit :]
    header = int(words[3])
    vertex_count, count, distance = header & 0xFF, header >> 8 & 0xFF, header >> 16
    vertices = words[4 : 4 + 3 * vertex_count].view(np.float32).reshape(3, vertex_count).T
    assert len(np.unique(vertices.view(np.uint32), axis=0)) == vertex_count <= 16
    corners = words[:3, None] >> 4 * np.arange(count, dtype=np.uint32) & 0xF
    assert corners.max() == vertex_count - 1
    size = -(-(4 + 3 * vertex_count + count) // 4)
    assert distance in (0, size)
    prims = words[4 + 3 * vertex_count :][:count].astype(np.int32)
    return prims, vertices[corners.T].reshape(count, 9), size, distance


def prims_of_leaf(units, unit):
    prims, corners, _, distance = unpack(units, unit)
    if not distance:
        return prims
    # Another block, since the next triangle would not fit this one.
    both = np.concatenate((corners, unpack(units, unit + distance)[1][:1])).reshape(-1, 3)
    assert len(np.unique(both.view(np.uint32), axis=0)) > 16
    return np.concatenate((prims, prims_of_leaf(units, unit + distance)))


def children_of(arrays, layout, node):
    """Yield the box and the child of each slot of a node: a node's index, or its primitives in an array."""
    nodes, blocks = arrays.nodes[node], arrays.blocks
    for slot in range(LAYOUTS[layout].width):
        if is_wide(layout):
            child = nodes["child"][slot]
            prims = None
            if child < 0:
                is_shared = blocks.dtype == SHARED_UNIT
                prims = prims_of_leaf(blocks, ~child) if is_shared else blocks["prim_id"][~child]
            box = nodes["aabb_min"][:, slot], nodes["aabb_max"][:, slot]
        else:
            child, count = nodes["first"][slot], nodes["count"][slot]
            prims = blocks["prim_id"][child : child + count] if count else None
            box = nodes["aabb_min"][slot], nodes["aabb_max"][slot]
        yield box, child if prims is None else prims


def rows_of(blocks, lanes):
    """Return the number and the coordinates in each lane of each block."""
    if blocks.dtype == SHARED_UNIT:
        unit, unpacked = 0, []
        while unit < len(blocks) - 4:
            prims, corners, size, _ = unpack(blocks, unit)
            unpacked.append((prims, corners))
            unit += size
        assert not blocks[-4:].view(np.uint32).any()
        return tuple(map(np.concatenate, zip(*unpacked, strict=True)))
    names = [name for name in blocks.dtype.names if name != "prim_id"]
    values = np.concatenate([blocks[name].reshape(len(blocks), -1, lanes) for name in names], axis=1)
    return blocks["prim_id"].reshape(-1), values.swapaxes(1, 2).reshape(len(blocks) * lanes, -1)


def check_arrays(arrays, layout, shape):
    """Every primitive is there once, below exact boxes; return the entries that a traversal's stack needs."""
    if isinstance(shape, Spheres):
        expected = np.column_stack((shape.local_centres, shape.local_radii))
    else:
        expected = shape.local_vertices[shape.faces].reshape(-1, 9)
        degenerate = shape.degenerate_faces
        # No ray hits them, or a lane without a triangle.
        expected[degenerate] = np.nan
    prims, values = rows_of(arrays.blocks, LAYOUTS[layout].block_width)
    np.testing.assert_array_equal(values, np.where((prims == NO_PRIM)[:, None], np.nan, expected[prims]))
    assert sorted(prims[prims != NO_PRIM].tolist()) == list(range(shape.prim_count))
    points, ids = shape.find_corners()
    visited = []

    def visit(node):
        """Return the primitives below a node, and the entries on the stack."""
        visited.append(node)
        found, below, slots = [], [0], list(children_of(arrays, layout, node))
        present = [(box[0] <= box[1]).all() for box, _ in slots]
        assert present == sorted(present, reverse=True)
        for (box, child), is_present in zip(slots, present, strict=True):
            if not is_present:
                assert (box[0] == GREATEST).all()
                assert (box[1] == -GREATEST).all()
                continue
            if isinstance(child, np.ndarray):
                inside = child[child != NO_PRIM]
                assert (child[: len(inside)] == inside).all()
            else:
                assert child > node
                inside, entries = visit(child)
                below.append(entries)
            corners = points[ids[inside]].reshape(-1, 3) + np.float32(0)
            assert box[0].tobytes() == corners.min(axis=0).tobytes()
            assert box[1].tobytes() == corners.max(axis=0).tobytes()
            found.append(inside)
        return np.concatenate(found), sum(present) - 1 + max(below)

    found, entries = visit(0)
    assert sorted(found.tolist()) == list(range(shape.prim_count))
    assert sorted(visited) == list(range(len(arrays.nodes)))
    return entries


def put(session, shape, plan, layout):
    """Return the trees of a device that are one shape's: a finished tree, or options by which the device builds it."""
    return DeviceTrees.join(session, [shape], [NewTree.make(session, shape, plan, layout)], layout)


def take(session, trees):
    """Return the arrays that a device has."""
    return Arrays(*trees.download(session, 0), trees.stack_size)


def refit(session, bvh, layout, *shapes):
    """Yield what refits a tree for one shape after the other on the device, the arrays, and the box."""
    trees = put(session, bvh.shape, bvh, layout)
    writer, retired = Refit(trees, 0, DevicePrims(session, session, bvh.shape), session), RetiredBuffers()
    for shape in shapes:
        moved = trees.with_room(session, 0, trees.trees[0], retired)
        for buffer in moved.buffers.values():
            session.write(buffer, np.full(buffer.size, 0xFF, np.uint8))
        box = writer.write(trees, moved, 0, shape, session)
        yield writer, take(session, moved), box


def bytes_of(arrays):
    return arrays.nodes.tobytes(), arrays.blocks.tobytes()


def tree_over(spheres, leaf_size=4):
    return build_tree(spheres, "sah", None, BuildOptions(leaf_size=leaf_size))


def make_trees():
    for count in (1, 2, 3, 5, 9, 17, 100, 2000):
        mesh = make_soup(count, count, grid=30, size=4, copies=0.2, degenerate=0.2, scale=-0.5)
        generator = np.random.default_rng(count)
        spheres = Spheres(generator.integers(-8, 9, (count, 3)) / 8, generator.choice([1e-30, 0.125, 0.5], count))
        for leaf_size in (1, 4, 30):
            yield build(mesh, leaf_size=leaf_size, traversal_cost=1e3 if leaf_size == 30 else 1)
            yield tree_over(spheres, leaf_size)
    generator = np.random.default_rng(1)
    yield build(Mesh.from_arrays(generator.normal(size=(12, 3)), generator.integers(0, 12, (300, 3))))
    zeros = np.random.default_rng(0).choice([-1.0, -0.0, 0.0, 1.0], (900, 3))
    yield build(Mesh.from_arrays(zeros, np.arange(900).reshape(-1, 3)))
    yield from (make_tree(), make_leaf(), make_leaf(1), make_chain(300, "left")[1], make_chain(300, "right")[1])


@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_arrays_hold_every_primitive_once_and_stay_as_they_are_if_nothing_moves(layout, session):
    for bvh in make_trees():
        arrays = arrays_of(bvh, layout)
        # An entry point can push children that a descent from the root would not push.
        spare = LAYOUTS[layout].width - 1 if is_wide(layout) else 0
        assert arrays.stack_size == check_arrays(arrays, layout, bvh.shape) + spare
        if has_shared_blocks(bvh.shape, layout):
            continue
        for writer, written, _ in refit(session, bvh, layout, bvh.shape):
            assert bytes_of(written) == bytes_of(arrays)
            assert writer.sah_cost == writer.built_cost


@pytest.mark.parametrize("layout", ["bvh2", "bvh4", "bvh8"])
def test_moved_vertices_have_exact_boxes(layout, session):
    bvh = build(make_soup(700, 1, grid=30, size=4, degenerate=0.2), leaf_size=3)
    # On a coarse grid, so that some triangles become degenerate and others cease to be.
    generator = np.random.default_rng(1)
    vertices = generator.integers(-4, 4, bvh.mesh.vertices.shape) * [1e3, 1.0, 1e-3]
    moved = bvh.refit(vertices)
    assert (moved.mesh.degenerate_faces & ~bvh.mesh.degenerate_faces).any()
    assert (~moved.mesh.degenerate_faces & bvh.mesh.degenerate_faces).any()
    point = bvh.mesh.with_vertices(np.ones_like(vertices))
    arrays = arrays_of(bvh, layout)
    (writer, written, box), (_, again, _) = refit(session, bvh, layout, moved.mesh, moved.mesh)
    check_arrays(written, layout, moved.mesh)
    assert bytes_of(written) == bytes_of(again)
    assert (box.half == np.abs(moved.mesh.local_vertices[moved.mesh.faces]).max(axis=(0, 1))).all()
    if layout == "bvh2":
        assert bytes_of(written) == bytes_of(arrays_of(moved, layout))
        assert writer.sah_cost / writer.built_cost == pytest.approx(sah_cost(moved) / sah_cost(bvh), rel=1e-6)
    ((writer, _, box),) = refit(session, bvh, layout, point)
    assert (writer.sah_cost, box.half.tolist()) == (len(arrays.nodes) + len(arrays.blocks), [0, 0, 0])
    spheres = Spheres(generator.normal(size=(700, 3)) + 100, generator.uniform(0.01, 0.1, 700))
    moved = spheres.with_spheres(spheres.centres[::-1] + 5, spheres.radii * 2)
    ((_, written, _),) = refit(session, tree_over(spheres), layout, moved)
    check_arrays(written, layout, moved)


@pytest.mark.parametrize("width", [4, 8])
def test_no_other_choice_of_wide_nodes_is_cheaper(width):
    """Against all ways to represent a small tree, tried one by one."""
    bvh = build(make_shape("blobs", triangles=80), leaf_size=1)
    first, count = bvh.nodes["first"], bvh.nodes["count"]
    x, y, z = (bvh.nodes["aabb_max"] - bvh.nodes["aabb_min"]).astype(np.float64).T
    areas = x * y + y * z + z * x
    price = float(wide.block_price(bvh.shape))
    known = {}

    def count_prims(node):
        return count[node] or count_prims(first[node]) + count_prims(first[node] + 1)

    def cost(node, children):
        """Return the least cost of a subtree that becomes at most `children` children."""
        if (node, children) not in known:
            ways, left = [], first[node]
            if count_prims(node) <= width:
                ways.append(areas[node] + price)
            if not count[node]:
                ways.append(areas[node] + min(cost(left, i) + cost(left + 1, width - i) for i in range(1, width)))
                ways += [cost(left, i) + cost(left + 1, n - i) for n in range(2, children + 1) for i in range(1, n)]
            known[node, children] = min(ways)
        return known[node, children]

    with HostThreads() as threads:
        nodes = wide.widen(bvh, width, threads).nodes
    x, y, z = np.moveaxis(nodes["aabb_max"].astype(np.float64) - nodes["aabb_min"], 1, 0)
    is_present, is_leaf = x >= 0, nodes["child"] < 0
    costs = x * y + y * z + z * x + is_leaf * price
    assert areas[0] + costs[is_present].sum() == pytest.approx(cost(0, 1), rel=1e-5)

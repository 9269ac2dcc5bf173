"""Device arrays around moved vertices and spheres, against arrays made anew and boxes found triangle by triangle."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, Spheres, build, sah_cost
from clbvh.builders.build import DEFAULT_BUILDER, build_tree
from clbvh.geometry.corners import find_corners
from clbvh.layouts import refit_arrays
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.layouts.refit_arrays import NO_CHILD, RefitArrays, read_topology
from clbvh.structs import LAYOUT_WIDTHS, NO_PRIM
from clbvh.support.host_threads import HostThreads

from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

LAYOUTS = [*LAYOUT_WIDTHS]


def write(arrays, layout, mesh, threads=1):
    """Return the object that wrote, and nodes and blocks for a mesh, in memory that was full of ones."""
    refit = RefitArrays(read_topology(arrays.nodes, arrays.blocks, layout))
    nodes, blocks = (np.empty_like(array) for array in (arrays.nodes, arrays.blocks))
    for array in (nodes, blocks):
        array.view(np.uint8)[:] = 0xFF
    with HostThreads(threads) as opened:
        refit.write(mesh, nodes, blocks, opened)
    return refit, nodes, blocks


def assert_tight(topology, nodes, blocks, shape):
    """Walk the tree: every child's box is the smallest one around the primitives below it."""
    is_wide = topology.prims.shape[1] > 1
    points, ids = find_corners(shape)

    def visit(node):
        prims = []
        for slot, child in enumerate(topology.children[node].tolist()):
            box = [nodes[side][node][:, slot] if is_wide else nodes[side][node][slot] for side in
                   ("aabb_min", "aabb_max")]  # fmt: skip
            if child == NO_CHILD:
                assert (box[0] > box[1]).all()
                continue
            below = visit(child) if child > 0 else blocks["prim_id"][slice(*topology.leaves[~child])].reshape(-1)
            below = below[below != NO_PRIM]
            corners = points[ids[below]].reshape(-1, 3)
            assert box[0].tobytes() == (corners.min(axis=0) + np.float32(0)).tobytes()
            assert box[1].tobytes() == (corners.max(axis=0) + np.float32(0)).tobytes()
            prims.append(below)
        return np.concatenate(prims)

    np.testing.assert_array_equal(np.sort(visit(0)), np.arange(shape.prim_count))


def assert_blocks_hold(blocks, mesh, *, is_wide):
    """Every triangle has its corners; degenerate ones are stored as the kernels expect them."""
    prims = blocks["prim_id"].reshape(-1)
    if is_wide:
        corners = np.moveaxis(blocks["corners"], 3, 1).reshape(-1, 3, 3)
    else:
        corners = np.stack([blocks[name] for name in "abc"], axis=1)
    expected = mesh.local_vertices[mesh.faces[prims]]
    degenerate = mesh.degenerate_faces[prims]
    expected[degenerate] = np.nan if is_wide else expected[degenerate, :1]
    expected[prims == NO_PRIM] = np.nan
    np.testing.assert_array_equal(corners, expected)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("leaf_size", [1, 4, 30])
@pytest.mark.parametrize("count", [1, 2, 5, 100, 3000])
def test_vertices_that_did_not_move_give_the_same_bytes(layout, leaf_size, count):
    bvh = build(make_soup(count, count, grid=30, size=4, copies=0.2, degenerate=0.2, scale=-0.5), leaf_size=leaf_size)
    arrays = make_device_arrays(bvh, layout)
    _, nodes, blocks = write(arrays, layout, bvh.mesh)
    assert nodes.tobytes() == arrays.nodes.tobytes()
    assert blocks.tobytes() == arrays.blocks.tobytes()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(3))
def test_moved_vertices_have_tight_boxes_and_their_corners(layout, seed):
    bvh = build(make_soup(700, seed, grid=30, size=4, degenerate=0.2), leaf_size=3)
    # On a coarse grid, so that some triangles become degenerate and others cease to be.
    vertices = np.random.default_rng(seed).integers(-4, 4, bvh.mesh.vertices.shape) * [1e3, 1.0, 1e-3]
    moved = bvh.refit(vertices)
    assert (moved.mesh.degenerate_faces & ~bvh.mesh.degenerate_faces).any()
    assert (~moved.mesh.degenerate_faces & bvh.mesh.degenerate_faces).any()
    refit, nodes, blocks = write(make_device_arrays(bvh, layout), layout, moved.mesh)
    assert_tight(refit.topology, nodes, blocks, moved.mesh)
    assert_blocks_hold(blocks, moved.mesh, is_wide=layout != "bvh2")
    if layout == "bvh2":
        arrays = make_device_arrays(moved, layout)
        assert nodes.tobytes() == arrays.nodes.tobytes()
        assert blocks.tobytes() == arrays.blocks.tobytes()
    root = moved.nodes[0]
    np.testing.assert_array_equal(refit.half, np.maximum(np.abs(root["aabb_min"]), np.abs(root["aabb_max"])))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("make", [make_tree, make_leaf])
def test_hand_made_trees_move(layout, make):
    bvh = make()
    moved = bvh.mesh.with_vertices(bvh.mesh.vertices[:, ::-1] * -3)
    refit, nodes, blocks = write(make_device_arrays(bvh, layout), layout, moved)
    assert_tight(refit.topology, nodes, blocks, moved)
    assert_blocks_hold(blocks, moved, is_wide=layout != "bvh2")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_number_of_threads_changes_nothing(layout, monkeypatch):
    monkeypatch.setattr(refit_arrays, "_PRIMS_PER_PART", 100)
    bvh = build(make_soup(2000, 5))
    arrays = make_device_arrays(bvh, layout)
    alone, four = (write(arrays, layout, bvh.mesh, threads) for threads in (1, 4))
    assert alone[1].tobytes() == four[1].tobytes() == arrays.nodes.tobytes()
    assert alone[2].tobytes() == four[2].tobytes() == arrays.blocks.tobytes()
    assert alone[0].sah_cost == four[0].sah_cost


@pytest.mark.parametrize("layout", LAYOUTS)
def test_negative_zeros_leave_no_trace(layout):
    vertices = np.random.default_rng(0).choice(np.array([-1.0, -0.0, 0.0, 1.0], np.float32), size=(3000, 3))
    bvh = build(Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3)))
    arrays = make_device_arrays(bvh, layout)
    _, nodes, _ = write(arrays, layout, bvh.refit(vertices).mesh)
    assert nodes.tobytes() == arrays.nodes.tobytes()


def test_the_cost_of_bvh2_is_the_sah_cost():
    bvh = build(make_soup(900, 3))
    moved = bvh.refit(bvh.mesh.vertices * [1, 2, -3] + 5 * np.sin(bvh.mesh.vertices[:, ::-1]))
    refit, _, _ = write(make_device_arrays(bvh, "bvh2"), "bvh2", moved.mesh)
    assert refit.sah_cost == pytest.approx(sah_cost(moved), rel=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_cost_of_a_mesh_without_extent_is_that_of_everything(layout):
    bvh = build(make_soup(50, 3))
    arrays = make_device_arrays(bvh, layout)
    refit, _, _ = write(arrays, layout, bvh.mesh.with_vertices(np.ones_like(bvh.mesh.vertices)))
    assert refit.sah_cost == len(arrays.nodes) + len(arrays.blocks)
    assert (refit.half == 0).all()


def test_the_topology_has_no_coordinates_and_no_memory_of_the_device():
    bvh = build(make_soup(300, 1))
    for layout in LAYOUTS:
        arrays = make_device_arrays(bvh, layout)
        topology = read_topology(arrays.nodes, arrays.blocks, layout)
        for array in topology:
            assert not np.shares_memory(array, arrays.nodes)
            assert not np.shares_memory(array, arrays.blocks)


def tree_over(spheres, leaf_size):
    return build_tree(spheres, DEFAULT_BUILDER, None, BuildOptions(leaf_size=leaf_size))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("leaf_size", [1, 4, 30])
@pytest.mark.parametrize("count", [1, 2, 5, 100, 3000])
def test_spheres_that_did_not_move_give_the_same_bytes(layout, leaf_size, count):
    generator = np.random.default_rng(count)
    # Some of them touch the planes through zero.
    spheres = Spheres(generator.integers(-8, 9, (count, 3)) / 8, generator.choice([1e-30, 0.125, 0.5], count))
    bvh = tree_over(spheres, leaf_size)
    arrays = make_device_arrays(bvh, layout)
    _, nodes, blocks = write(arrays, layout, spheres)
    assert nodes.tobytes() == arrays.nodes.tobytes()
    assert blocks.tobytes() == arrays.blocks.tobytes()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("threads", [1, 3])
def test_spheres_that_moved_lie_in_tight_boxes(layout, threads, monkeypatch):
    monkeypatch.setattr(refit_arrays, "_PRIMS_PER_PART", 100)
    generator = np.random.default_rng(8)
    spheres = Spheres(generator.normal(size=(700, 3)), generator.uniform(0.01, 0.1, 700))
    arrays = make_device_arrays(tree_over(spheres, 4), layout)
    moved = spheres.with_spheres(spheres.centres[::-1] + 5, spheres.radii * 2)
    refit, nodes, blocks = write(arrays, layout, moved, threads)
    assert_tight(refit.topology, nodes, blocks, moved)
    prims = blocks["prim_id"].reshape(-1)
    is_wide = refit.topology.prims.shape[1] > 1
    centres = np.moveaxis(blocks["centre"], 1, 2).reshape(-1, 3) if is_wide else blocks["centre"]
    is_there = prims != NO_PRIM
    np.testing.assert_array_equal(centres[is_there], moved.local_centres[prims[is_there]])
    np.testing.assert_array_equal(blocks["radius"].reshape(-1)[is_there], moved.local_radii[prims[is_there]])
    assert np.isnan(centres[~is_there]).all()
    np.testing.assert_array_equal(refit.half, np.abs(find_corners(moved).points).max(axis=0))

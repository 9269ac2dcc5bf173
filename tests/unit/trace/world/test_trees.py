"""What is uploaded for a tree, and what its kernels are compiled with."""

from dataclasses import replace

import numpy as np
import pytest

from clbvh import ConfigError, DeviceError, build, make_shape
from clbvh.kinds import TRIANGLE
from clbvh.tree_layouts import LAYOUTS, TREE_LAYOUTS

from ....chain import make_chain
from ....worlds import arrays_of, open_mesh


@pytest.fixture(scope="module")
def bvh():
    return build(make_shape("blobs", triangles=640))


@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_a_tree_is_uploaded_in_its_layout(session, bvh, layout):
    world = open_mesh(session, bvh.mesh, bvh, layout)
    arrays = arrays_of(bvh, layout)
    nodes, blocks, count = (world.arguments[name] for name in ("nodes", "blocks", "block_count"))
    assert count == len(arrays.blocks)
    for buffer, expected in ((nodes, arrays.nodes), (blocks, arrays.blocks)):
        obtained = np.empty_like(expected)
        session.download(buffer, obtained)
        assert obtained.tobytes() == expected.tobytes()
    assert world.memory_bytes == arrays.nodes.nbytes + arrays.blocks.nbytes
    assert world.defines["LAYOUT"] == LAYOUTS[layout].number
    assert arrays.stack_size <= world.defines["STACK_SIZE"] == LAYOUTS[layout].common_stack


@pytest.mark.parametrize(("triangles", "stack_size"), [(1, 32), (2, 32), (33, 32), (34, 48), (49, 48), (50, 64)])
def test_the_stack_holds_the_depth_of_the_tree(session, triangles, stack_size):
    mesh, chain = make_chain(triangles, "right")
    assert chain.depth == triangles - 1
    assert open_mesh(session, mesh, chain, "bvh2").defines["STACK_SIZE"] == stack_size


def test_a_tree_that_is_too_deep_and_unknown_layouts_are_refused(session):
    assert open_mesh(session, *make_chain(1025, "left"), "bvh2").defines["STACK_SIZE"] == 1024
    with pytest.raises(ConfigError, match="the tree is too deep: as bvh2 it needs a stack of 1,025 entries"):
        open_mesh(session, *make_chain(1026, "left"), "bvh2")
    for layout in ("brute", "bvh3", ""):
        with pytest.raises(ConfigError, match=rf"one of auto, bvh2.*, not '{layout}'$"):
            open_mesh(session, *make_chain(3, "left"), layout)


def test_large_scenes_get_the_compact_layout_and_what_fits_nowhere_is_refused(session):
    mesh = make_shape("blobs", triangles=4000)
    bvh = build(mesh)
    for layout, per_triangle, expected in (
        ("auto", 61, session.info.layout),
        ("auto", 40, "bvh8c"),
        ("auto", 14, "at least .* in the layout bvh8c, .*: cut the mesh by `clbvh shard`"),
        ("bvh8", 39, "take the layout bvh8c"),
    ):
        with session.branch() as small:
            small.info = replace(session.info, max_allocation_bytes=per_triangle * mesh.face_count)
            if expected in LAYOUTS:
                assert open_mesh(small, mesh, bvh, layout).layout == expected
            else:
                with pytest.raises(DeviceError, match=expected):
                    open_mesh(small, mesh, bvh, layout)


def test_without_a_tree_there_are_triangles_only(session, bvh):
    assert open_mesh(session, bvh.mesh, bvh, "auto").layout == session.info.layout
    world = open_mesh(session, bvh.mesh)
    assert world.layout == "brute"
    assert (world.defines["LAYOUT"], world.defines["STACK_SIZE"]) == (LAYOUTS["brute"].number, 16)
    assert world.memory_bytes == bvh.mesh.face_count * TRIANGLE.itemsize
    triangles = np.empty(bvh.mesh.face_count, TRIANGLE)
    session.download(world.arguments["blocks"], triangles)
    np.testing.assert_array_equal(triangles["prim_id"], np.arange(bvh.mesh.face_count))

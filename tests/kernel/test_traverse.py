"""Traversal: a tree changes how long the answer takes, and not one bit of it."""

import numpy as np
import pytest

from clbvh import build
from clbvh.geometry import Mesh
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.structs import HIT, LAYOUT_WIDTHS, LAYOUTS, NO_PRIM

from ..chain import make_chain
from ..rays import centred, hard_rays, mesh_as_on_device
from ..soup import make_soup
from ..worlds import open_mesh
from .casting import STACK_SIZE, open_caster

RAYS = 30_000
SHAPES = {"icosphere": 500, "knot": 1200, "terrain": 800, "blobs": 640, "boxes": 600}


def check_tree_and_brute_agree(session, mesh, bvh, rays, **limits):
    """Compare all results of all layouts with those of no tree, byte for byte; return the closest hits."""
    with open_caster(session, mesh, None) as without:
        expected = {query: without(query, *rays, **limits) for query in ("closest_hit", "any_hit", "count_hits")}
        crossings = without("all_hits", *rays, **limits)[0]
    hits = expected["closest_hit"]
    np.testing.assert_array_equal(expected["any_hit"], (hits["prim_id"] != NO_PRIM).astype(np.uint8))
    for layout in LAYOUT_WIDTHS:
        with open_caster(session, mesh, bvh, layout) as with_tree:
            obtained = with_tree("closest_hit", *rays, **limits)
            for field in hits.dtype.names:
                np.testing.assert_array_equal(obtained[field], hits[field], err_msg=f"{layout}: {field}")
            for query, results in expected.items():
                assert with_tree(query, *rays, **limits).tobytes() == results.tobytes(), (layout, query)
            assert with_tree("all_hits", *rays, **limits)[0].tobytes() == crossings.tobytes(), layout
    return hits


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("shape", SHAPES)
def test_procedural_meshes(session, shape, seed):
    mesh = centred(make_shape(shape, triangles=SHAPES[shape], seed=seed))
    rays = hard_rays(mesh, RAYS, np.random.default_rng([20, seed]))
    hits = check_tree_and_brute_agree(session, mesh, build(mesh), rays)
    assert 0.3 < np.mean(hits["prim_id"] != NO_PRIM) < 1
    assert len(np.unique(hits["prim_id"])) > 0.5 * mesh.face_count


@pytest.mark.parametrize("leaf_size", [1, 2, 15, 255])
def test_leaves_of_any_size(session, leaf_size):
    mesh = centred(make_shape("knot", triangles=1200))
    rays = hard_rays(mesh, RAYS, np.random.default_rng(21))
    bvh = build(mesh, leaf_size=leaf_size, traversal_cost=1000 if leaf_size > 2 else 1)
    assert bvh.nodes["count"].max() > 0.5 * leaf_size
    check_tree_and_brute_agree(session, mesh, bvh, rays)


def test_limits_cut_both_ends(session):
    mesh = centred(make_shape("blobs", triangles=640))
    origins, directions = hard_rays(mesh, RAYS, np.random.default_rng(22))
    generator = np.random.default_rng(23)
    t_min, t_max = generator.uniform(0, 1, RAYS), generator.uniform(0.5, 2, RAYS)
    hits = check_tree_and_brute_agree(session, mesh, build(mesh), (origins, directions), t_min=t_min, t_max=t_max)
    found = hits["prim_id"] != NO_PRIM
    assert 0.1 < found.mean() < 0.9
    assert (hits["t"][found] >= t_min[found].astype(np.float32)).all()
    assert (hits["t"][found] <= t_max[found].astype(np.float32)).all()


def test_soups_on_a_small_grid(session):
    # Equal triangles, equal distances, degenerate triangles, flat boxes: all ties there are.
    mesh = centred(make_soup(600, seed=3, grid=6, size=3, copies=0.3, degenerate=0.2))
    origins, directions = hard_rays(mesh, RAYS, np.random.default_rng(24))
    on_grid = np.round(origins * 2) / 2, np.round(directions)
    kept = np.abs(on_grid[1]).max(axis=1) > 0
    hits = check_tree_and_brute_agree(session, mesh, build(mesh), tuple(rows[kept] for rows in on_grid))
    assert not mesh.degenerate_faces[hits["prim_id"][hits["prim_id"] != NO_PRIM]].any()
    # Of equal triangles the first is found.
    corners = mesh.vertices[mesh.faces].reshape(mesh.face_count, -1)
    _, first, which = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    prim = hits["prim_id"][hits["prim_id"] != NO_PRIM]
    np.testing.assert_array_equal(first[which.ravel()[prim]], prim)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("degenerate", [False, True])
def test_a_tree_that_is_one_leaf(session, count, degenerate):
    corners = np.random.default_rng([25, count]).uniform(-1, 1, (count, 3, 3))
    if degenerate:
        corners[0, 2] = corners[0, 1]
    mesh = centred(Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)))
    bvh = build(mesh, leaf_size=4, traversal_cost=100)
    assert bvh.node_count == 1
    hits = check_tree_and_brute_agree(session, mesh, bvh, hard_rays(mesh, 3000, np.random.default_rng(26)))
    assert (NO_PRIM in hits["prim_id"]) or count > 1
    assert set(range(count)) - set(hits["prim_id"].tolist()) == ({0} if degenerate else set())


# As deep as the stack is long.
CHAIN = STACK_SIZE + 1


@pytest.mark.parametrize("leaf_side", ["left", "right"])
@pytest.mark.parametrize("toward", [1, -1], ids=["leaf-first", "leaf-last"])
def test_the_stack_is_as_deep_as_the_tree(session, leaf_side, toward):
    """Seen from the far end every leaf is on the stack when the traversal reaches the last node: it is full."""
    mesh, bvh = make_chain(CHAIN, leaf_side)
    assert open_mesh(session, mesh, bvh, "bvh2").defines["STACK_SIZE"] == bvh.depth == STACK_SIZE
    x, y = np.random.default_rng(27).uniform(0, 2, (2, 2000))
    distinct = np.abs(x + y - 2) > 1e-3
    x, y = x[distinct], y[distinct]
    origins = np.stack((x, y, np.full(len(x), -5.0 if toward > 0 else CHAIN + 5.0)), axis=1)
    directions = np.broadcast_to([0.0, 0.0, toward], origins.shape)
    hits = check_tree_and_brute_agree(session, mesh, bvh, (origins, directions))
    lower_triangle = 0 if toward > 0 else CHAIN - 2
    np.testing.assert_array_equal(hits["prim_id"], np.where(x + y > 2, CHAIN - 1, lower_triangle))


def find_any(run_shell, make_rays, bvh, origins, directions, layout="bvh2"):
    """The triangles at which a search for anything ends, and how many crossings it met on the way."""
    arrays = make_device_arrays(bvh, layout)
    inputs = [make_rays(origins, directions), arrays.nodes, arrays.blocks]
    hits, reported = run_shell(
        "find_any", inputs, [HIT, HIT], "find_any", {"LAYOUT": LAYOUTS[layout], "STACK_SIZE": 64}
    )
    return hits["prim_id"].tolist(), reported["prim_id"].tolist()


@pytest.mark.parametrize("leaf_side", ["left", "right"])
def test_the_near_child_comes_first(run_shell, make_rays, leaf_side):
    _, bvh = make_chain(CHAIN, leaf_side)
    origins, directions = [[0.5, 0.5, -5], [0.5, 0.5, CHAIN + 5]], [[0, 0, 1], [0, 0, -1]]
    assert find_any(run_shell, make_rays, bvh, origins, directions) == ([0, CHAIN - 2], [1, 1])


def test_any_crossing_ends_the_search(session, run_shell, make_rays):
    # The slope's box is entered first, and hit; the plate in front of the hit would be found by searching on.
    slope, plate = [[0, 0, 0], [1, 0, 10], [0, 1, 0]], [[0, 0, 5], [1, 0, 5], [0, 1, 5]]
    mesh = mesh_as_on_device(np.subtract(slope + plate, [0.5, 0.5, 5]), [[0, 1, 2], [3, 4, 5]])
    bvh = build(mesh, leaf_size=1)
    assert bvh.depth == 1
    origins, directions = np.array([[0.3, -0.4, -20]]), np.array([[0, 0, 1]])
    assert find_any(run_shell, make_rays, bvh, origins, directions) == ([0], [1])
    with open_caster(session, mesh, bvh) as cast:
        assert cast("closest_hit", origins, directions)["prim_id"].tolist() == [1]


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
def test_any_crossing_ends_the_search_in_every_layout(run_shell, make_rays, layout):
    """The ray crosses all triangles, and of the first block no more than fit it are reported."""
    _, bvh = make_chain(CHAIN, "left")
    _, reported = find_any(run_shell, make_rays, bvh, [[0.5, 0.5, -5]], [[0, 0, 1]], layout)
    assert 1 <= reported[0] <= {"bvh2": 1}.get(layout, LAYOUT_WIDTHS[layout])

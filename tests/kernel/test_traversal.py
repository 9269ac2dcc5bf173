"""Traversal: trees, layouts, entry points and what only GPUs do change the time of an answer, and no bit of it.

More meshes, and all builders: `tests/property/test_layouts.py`.
"""

import numpy as np
import pytest

from clbvh import Tracer, build, make_shape
from clbvh.structs import NO_PRIM
from clbvh.trace.world.world import World
from clbvh.tree_layouts import LAYOUTS, TREE_LAYOUTS, WIDE_LAYOUTS
from clbvh.views.cameras.framing import frame_mesh

from ..chain import make_chain
from ..rays import centred, hard_rays
from ..soup import make_soup
from ..worlds import arrays_of, open_mesh
from .casting import STACK_SIZE, open_caster
from .programs import make_rays

pytestmark = pytest.mark.on_both

QUERIES = ("closest_hit", "any_hit", "count_hits", "all_hits")
FEW_HITS = 3


def answer(cast, rays, **limits):
    """The answers of all queries to rays, by name."""
    answers = {query: cast(query, *rays, **limits) for query in QUERIES[:3]}
    answers["all_hits"], answers["offsets"] = cast("all_hits", *rays, **limits)
    answers["few"], answers["few offsets"] = cast("all_hits", *rays, **limits, max_hits=FEW_HITS)
    return answers


def check_alike(found, expected, name):
    """Compare answers, byte for byte."""
    for query, answers in expected.items():
        np.testing.assert_array_equal(found[query], answers, err_msg=f"{name}, {query}")
        assert found[query].tobytes() == answers.tobytes(), (name, query)


def check_queries(answers):
    """Hold all queries against each other: one order of hits, each once, and the first of them everywhere."""
    hits, counts = answers["all_hits"], np.diff(answers["offsets"])
    np.testing.assert_array_equal(answers["count_hits"], counts)
    np.testing.assert_array_equal(answers["any_hit"], counts > 0)
    closest = answers["closest_hit"]
    np.testing.assert_array_equal(closest["prim_id"] != NO_PRIM, counts > 0)
    assert hits[answers["offsets"][:-1][counts > 0]].tobytes() == closest[counts > 0].tobytes()
    ray = np.repeat(np.arange(len(counts)), counts)
    np.testing.assert_array_equal(np.lexsort((hits["prim_id"], hits["t"], ray)), np.arange(len(hits)))
    assert len(np.unique(np.stack((ray, hits["prim_id"])), axis=1).T) == len(hits)
    np.testing.assert_array_equal(np.diff(answers["few offsets"]), np.minimum(counts, FEW_HITS))
    assert answers["few"].tobytes() == hits[np.arange(len(hits)) - answers["offsets"][ray] < FEW_HITS].tobytes()


def check_layouts(session, mesh, bvh, rays, **limits):
    """Compare the answers in all layouts with those of no tree; return the latter."""
    with open_caster(session, mesh) as cast:
        expected = answer(cast, rays, **limits)
    check_queries(expected)
    for layout in TREE_LAYOUTS:
        with open_caster(session, mesh, bvh, layout) as cast:
            check_alike(answer(cast, rays, **limits), expected, layout)
    return expected


def grid_soup():
    """Equal triangles, equal distances, degenerate triangles, flat boxes: all ties there are."""
    return centred(make_soup(600, seed=3, grid=6, size=3, copies=0.3, degenerate=0.2))


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
    rays = origins, np.broadcast_to([0.0, 0.0, toward], origins.shape)
    hits = check_layouts(session, mesh, bvh, rays)["closest_hit"]
    np.testing.assert_array_equal(hits["prim_id"], np.where(x + y > 2, CHAIN - 1, 0 if toward > 0 else CHAIN - 2))
    for layout in WIDE_LAYOUTS:
        check_tiles(session, mesh, bvh, rays, (8, 8), layout)


# Counts the crossings that a search is told of in its heap, which no count of crossings uses.
COUNTING = """
#include "hits/search.cl"
#define add_crossing(search, crossing, query) ((search)->heap->prim_id++, add_crossing(search, crossing, query))
#include "traversal/traverse.cl"
"""


def find_any(call, bvh, origins, directions, layout="bvh2"):
    """The triangles at which a search for anything ends, and how many crossings it met on the way."""
    arrays = arrays_of(bvh, layout)
    body = """
        const ray_t unpacked = unpack_ray(ray);
        search_t search = make_search(1, met);
        traverse(nodes, nodes, blocks, 0, &unpacked, &search, QUERY_COUNT);
        hit = as_hit(&search.nearest);
    """
    tables = {"nodes": arrays.nodes, "blocks": arrays.blocks}
    rays = make_rays(origins, directions)
    hits, met = call(COUNTING, body, "hit_t hit, hit_t met[1]", ray=rays, tables=tables, layout=layout)
    return hits["prim_id"].tolist(), met["prim_id"].ravel().tolist()


def test_the_near_child_comes_first_and_any_crossing_ends_the_search(call):
    for leaf_side in ("left", "right"):
        _, bvh = make_chain(CHAIN, leaf_side)
        origins, directions = [[0.5, 0.5, -5], [0.5, 0.5, CHAIN + 5]], [[0, 0, 1], [0, 0, -1]]
        assert find_any(call, bvh, origins, directions) == ([0, CHAIN - 2], [1, 1])
    # The ray crosses all triangles, and of the first block no more than fit it are reported.
    for layout, width in ((name, LAYOUTS[name].width) for name in TREE_LAYOUTS):
        _, met = find_any(call, bvh, origins[:1], directions[:1], layout)
        assert 1 <= met[0] <= (1 if layout == "bvh2" else width)


WIDTH, HEIGHT = 203, 117  # neither is a multiple of a tile's

# The first child of an entry point: no entry point was found, or the tile's rays hit nothing.
ROOT, NO_CHILD = 0, -1


def check_tiles(session, mesh, bvh, rays, tile, layout, **limits):
    """Compare all answers with those of rays that begin at the root; return the closest hits."""
    with open_caster(session, mesh, bvh, layout) as cast:
        expected = answer(cast, rays, **limits)
    with open_caster(session, mesh, bvh, layout, row_length=WIDTH, tile=tile, with_entry_points=True) as cast:
        check_alike(answer(cast, rays, **limits), expected, f"{layout}, tiles {tile}")
    return expected["closest_hit"]


def picture(mesh):
    """The rays of a picture."""
    origins, directions = frame_mesh(mesh, aspect=WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def any_order(mesh):
    return hard_rays(mesh, WIDTH * HEIGHT // 3 * 3, np.random.default_rng(39))


@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
def test_tiles_of_rays_begin_at_entry_points(session, mesh, layout):
    soup, few = grid_soup(), centred(make_soup(3, seed=1, grid=8, size=4))
    one_leaf = build(few, leaf_size=4, traversal_cost=100)
    for tile in ((8, 8), (64, 1), (5, 3)):
        hits = check_tiles(session, mesh, build(mesh), picture(mesh), tile, layout)
        assert 0.02 < np.mean(hits["prim_id"] != NO_PRIM) <= 1
    check_tiles(session, mesh, build(mesh), any_order(mesh), (8, 8), layout)
    check_tiles(session, soup, build(soup), picture(soup), (8, 8), layout)
    check_tiles(session, few, one_leaf, picture(few), (8, 8), layout)
    # Limits, and a tile of one row that is cut off.
    whole_rows = HEIGHT // 2 // 8 * 8
    rays = tuple(part[: whole_rows * WIDTH + 2 * WIDTH // 3] for part in picture(mesh))
    hits = check_tiles(session, mesh, build(mesh), rays, (8, 8), layout)
    assert (hits["prim_id"][whole_rows * WIDTH :] != NO_PRIM).any()
    reach = 4 * float(np.ptp(mesh.vertices, axis=0).max())
    t_min, t_max = reach * np.random.default_rng(37).uniform([[0], [0.2]], [[0.5], [1]], (2, len(rays[0])))
    check_tiles(session, mesh, build(mesh), rays, (8, 8), layout, t_min=t_min, t_max=t_max)


@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
def test_a_picture_gets_entry_points_and_rays_in_no_order_do_not(session, layout):
    mesh = centred(make_shape("knot", triangles=20_000))
    rays = picture(mesh)
    order = np.random.default_rng(38).permutation(len(rays[0]))
    with open_caster(session, mesh, build(mesh), layout, row_length=WIDTH, tile=(8, 8)) as cast:
        first = cast.find_entry_points(*rays)["child"][:, 0]
        shuffled = cast.find_entry_points(*(rows[order] for rows in rays))["child"][:, 0]
    assert (first == ROOT).mean() < 0.2
    assert 0.2 < (first == NO_CHILD).mean() < 0.9
    # Most of the others are far down in the tree.
    assert np.median(first[first > ROOT]) > 8
    assert (shuffled == ROOT).mean() > 0.9


def ask(tracer, rays):
    """What a GPU finds in its own way: hits, and how much is seen around where some rays begin."""
    hits = tracer.closest_hit(*rays)
    light = tracer.ambient_occlusion(*(part[:200] for part in rays), rays=70, offset=1e-4)
    assert 0 < light.mean() < 1
    return [part.tobytes() for part in (hits.t, hits.prim_id, tracer.any_hit(*rays), light)]


@pytest.mark.on_opencl
@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_what_only_gpus_do_changes_no_hit(source, rays, open_tracer, monkeypatch, layout):
    expected = ask(open_tracer(source, layout=layout), rays)
    defines = World.defines.func
    monkeypatch.setattr(World, "defines", property(lambda world: defines(world) | {"IS_GPU": 1}))
    with Tracer(source, layout=layout) as tracer:
        assert ask(tracer, rays) == expected

"""Tiles of rays that begin at entry points hit what they hit from the root, bit for bit."""

import numpy as np
import pytest

from clbvh import build
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.structs import NO_PRIM

from ..chain import make_chain
from ..rays import axis_rays, centred, feature_rays, hard_rays, random_rays
from ..soup import make_soup
from .casting import STACK_SIZE, open_caster
from .test_slabs import LAYOUT_NAMES

WIDTH, HEIGHT = 203, 117  # neither is a multiple of a tile's
TILES = [(8, 8), (16, 4), (64, 1), (5, 3)]
QUERIES = ("closest_hit", "any_hit", "count_hits", "all_hits")

# The first child of an entry point: no entry point was found, or the tile's rays hit nothing.
ROOT, NO_CHILD = 0, -1


def picture(mesh, generator):
    """Rays of a picture."""
    camera = frame_mesh(mesh, aspect=WIDTH / HEIGHT)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def parallel_grid(mesh, generator):
    """Along an axis, through vertices of the mesh: a grid with them sorted across."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    x = np.sort(generator.choice(mesh.vertices[:, 0], WIDTH))
    y = np.sort(generator.choice(mesh.vertices[:, 1], HEIGHT))
    origins = np.stack((*np.meshgrid(x, y), np.full((HEIGHT, WIDTH), -2 * size)), axis=-1).reshape(-1, 3)
    return origins, np.broadcast_to([0.0, 0.0, 1.0], origins.shape)


def from_inside(mesh, generator):
    """A panorama from the middle: directions of all signs, and along the axes."""
    turn = np.round(np.linspace(-np.pi, np.pi, WIDTH), 2)
    rise = np.linspace(-1.5, 1.5, HEIGHT)[:, None]
    directions = np.stack(
        np.broadcast_arrays(np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)), -1
    )
    directions[HEIGHT // 2, :: WIDTH // 4] = np.round(directions[HEIGHT // 2, :: WIDTH // 4])
    directions = directions.reshape(-1, 3)
    return np.broadcast_to(np.float32(mesh.vertices.mean(axis=0)), directions.shape), directions


def sorted_features(mesh, generator):
    """To vertices and edges, neighbours beside each other."""
    origins, directions = feature_rays(mesh, WIDTH * HEIGHT, generator)
    order = np.lexsort((origins + directions).round(1).T)
    return np.broadcast_to(origins[0], origins.shape), (origins + directions - origins[0])[order]


KINDS = (picture, parallel_grid, from_inside, sorted_features, random_rays, axis_rays)


def make_kind(kind, mesh, generator):
    return kind(mesh, WIDTH * HEIGHT, generator) if kind in (random_rays, axis_rays) else kind(mesh, generator)


def check_entry_points_change_nothing(session, mesh, bvh, rays, tile, layout, **limits):
    """Compare all results with those of rays that begin at the root, byte for byte; return the closest hits."""
    with open_caster(session, mesh, bvh, layout) as cast:
        expected = {query: cast(query, *rays, **limits) for query in QUERIES}
    with open_caster(session, mesh, bvh, layout, row_length=WIDTH, tile=tile, with_entry_points=True) as cast:
        for query, results in expected.items():
            obtained = cast(query, *rays, **limits)
            for one, other in zip(*((r if isinstance(r, tuple) else (r,)) for r in (obtained, results)), strict=True):
                assert one.tobytes() == other.tobytes(), query
    return expected["closest_hit"]


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", ["knot", "blobs", "boxes"])
def test_all_kinds_of_rays(session, shape, kind, layout):
    mesh = centred(make_shape(shape, triangles=3000, seed=5))
    rays = make_kind(kind, mesh, np.random.default_rng(36))
    hits = check_entry_points_change_nothing(session, mesh, build(mesh), rays, (8, 8), layout)
    assert 0.02 < np.mean(hits["prim_id"] != NO_PRIM) <= 1


@pytest.mark.parametrize("tile", TILES)
def test_tiles_of_any_shape(session, tile):
    mesh = centred(make_shape("icosphere", triangles=1280))
    check_entry_points_change_nothing(session, mesh, build(mesh), picture(mesh, None), tile, "bvh8")


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_limits_and_rows_that_are_cut_off(session, layout):
    mesh = centred(make_shape("terrain", triangles=2000, seed=6))
    generator = np.random.default_rng(37)
    origins, directions = (rows[: -WIDTH // 3] for rows in picture(mesh, generator))
    reach = 4 * float(np.ptp(mesh.vertices, axis=0).max())
    t_min, t_max = reach * generator.uniform(0, 0.5, len(origins)), reach * generator.uniform(0.2, 1, len(origins))
    hits = check_entry_points_change_nothing(
        session, mesh, build(mesh), (origins, directions), (8, 8), layout, t_min=t_min, t_max=t_max
    )
    assert 0.02 < np.mean(hits["prim_id"] != NO_PRIM) < 0.9


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_a_tile_of_one_row_that_is_cut_off(session, layout):
    mesh = centred(make_shape("icosphere", triangles=1280))
    whole_rows = HEIGHT // 2 // 8 * 8
    rays = tuple(part[: whole_rows * WIDTH + 2 * WIDTH // 3] for part in picture(mesh, None))
    hits = check_entry_points_change_nothing(session, mesh, build(mesh), rays, (8, 8), layout)
    assert (hits["prim_id"][whole_rows * WIDTH :] != NO_PRIM).any()


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_soups_on_a_small_grid(session, layout):
    mesh = centred(make_soup(600, seed=3, grid=6, size=3, copies=0.3, degenerate=0.2))
    x, y = np.meshgrid(np.linspace(-4, 4, WIDTH).round(1), np.linspace(-4, 4, HEIGHT).round(1))
    origins = np.stack((x, y, np.full(x.shape, -9.0)), axis=-1).reshape(-1, 3)
    rays = origins, np.broadcast_to([0.0, 0.0, 1.0], origins.shape)
    check_entry_points_change_nothing(session, mesh, build(mesh), rays, (8, 8), layout)


@pytest.mark.parametrize("leaf_side", ["left", "right"])
def test_the_stack_of_a_deep_tree_is_long_enough(session, leaf_side):
    mesh, bvh = make_chain(STACK_SIZE + 1, leaf_side)
    x, y = np.meshgrid(np.linspace(0.01, 1.99, WIDTH), np.linspace(0.013, 1.97, HEIGHT))
    for toward in (1, -1):
        origins = np.stack((x, y, np.full(x.shape, -5.0 if toward > 0 else 54.0)), axis=-1).reshape(-1, 3)
        rays = origins, np.broadcast_to([0.0, 0.0, toward], origins.shape)
        for layout in LAYOUT_NAMES:
            hits = check_entry_points_change_nothing(session, mesh, bvh, rays, (8, 8), layout)
            assert (hits["prim_id"] != NO_PRIM).all()


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_a_tree_that_is_one_leaf(session, layout):
    mesh = centred(make_soup(3, seed=1, grid=8, size=4))
    bvh = build(mesh, leaf_size=4, traversal_cost=100)
    check_entry_points_change_nothing(session, mesh, bvh, picture(mesh, None), (8, 8), layout)


def find_first_children(session, mesh, layout, rays, tile):
    """The first child of the entry point of each tile."""
    with open_caster(session, mesh, build(mesh), layout, row_length=WIDTH, tile=tile) as cast:
        return cast.find_entry_points(*rays)["child"][:, 0]


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_a_picture_gets_entry_points_and_rays_in_no_order_do_not(session, layout):
    mesh = centred(make_shape("knot", triangles=20_000))
    rays = picture(mesh, None)
    first = find_first_children(session, mesh, layout, rays, (8, 8))
    assert (first == ROOT).mean() < 0.2
    assert 0.2 < (first == NO_CHILD).mean() < 0.9
    # Most of the others are far down in the tree.
    assert np.median(first[(first > ROOT)]) > 8
    order = np.random.default_rng(38).permutation(len(rays[0]))
    first = find_first_children(session, mesh, layout, tuple(rows[order] for rows in rays), (8, 8))
    assert (first == ROOT).mean() > 0.9


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_hard_rays_in_any_order(session, layout):
    mesh = centred(make_shape("blobs", triangles=640))
    rays = hard_rays(mesh, WIDTH * HEIGHT // 3 * 3, np.random.default_rng(39))
    check_entry_points_change_nothing(session, mesh, build(mesh), rays, (64, 1), layout)

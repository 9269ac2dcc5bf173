"""Trees over spheres in all layouts: traversal finds the bytes that a test of all spheres finds."""

import numpy as np
import pytest

from clbvh import BuildOptions
from clbvh.builders.build import build_tree
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.layouts.leaf_blocks import gather_blocks
from clbvh.structs import BVH2_NODE, HIT, LAYOUT_WIDTHS, LAYOUTS, NO_PRIM

from ..profiles import seeds
from ..spheres import make_spheres, sphere_rays, spheres_as_on_device

RAYS = 20_000
SLOTS = 6
STACK_SIZE = 48


def trace(run_shell, rays, nodes, blocks, layout, sphere_count):
    """Closest hits, counts, first hits, and the spheres nearest to the origins."""
    return run_shell(
        "trace_spheres", [rays, nodes, blocks, np.full(len(rays), sphere_count, np.int32)],
        [HIT, np.int32, (HIT, (SLOTS,)), np.int32], "sphere_shells",
        {"LAYOUT": LAYOUTS[layout], "STACK_SIZE": STACK_SIZE, "HAS_SPHERES": 1},
    )  # fmt: skip


def check_all_layouts_agree(run_shell, spheres, rays, **options):
    """Compare all results of all layouts with those of no tree, byte for byte; return the latter."""
    count = spheres.prim_count
    all_spheres = gather_blocks(spheres, np.arange(count, dtype=np.int32).reshape(-1, 1))
    expected = trace(run_shell, rays, np.zeros(1, BVH2_NODE), all_spheres, "brute", count)
    bvh = build_tree(spheres, "sah", None, BuildOptions(**options))
    for layout in LAYOUT_WIDTHS:
        arrays = make_device_arrays(bvh, layout)
        assert arrays.stack_size <= STACK_SIZE
        obtained = trace(run_shell, rays, arrays.nodes, arrays.blocks, layout, count)
        for name, one, other in zip(("closest", "counts", "first", "nearest"), obtained, expected, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=f"{layout}: {name}")
    return expected


@pytest.mark.parametrize("seed", seeds(2))
@pytest.mark.parametrize(("count", "sizes"), [(300, (-3, -0.5)), (2000, (-6, -2)), (200, (-12, 0))])
def test_spheres_of_many_sizes(run_shell, make_rays, seed, count, sizes):
    generator = np.random.default_rng([91, seed, count])
    spheres = make_spheres(count, generator, sizes)
    closest, counts, first, nearest = check_all_layouts_agree(
        run_shell, spheres, make_rays(*sphere_rays(spheres, RAYS, generator))
    )
    assert 0.3 < (closest["prim_id"] != NO_PRIM).mean() < 1
    assert (counts > SLOTS).any() or count == 2000
    np.testing.assert_array_equal(first[:, 0], closest)
    assert len(np.unique(nearest)) > 0.2 * count


def test_the_hits_are_those_of_float64(run_shell, make_rays):
    """All spheres by the formula, for rays that no rounding brings near a rim or a tie."""
    generator = np.random.default_rng(92)
    spheres = make_spheres(200, generator, (-2, -0.5))
    origins, directions = sphere_rays(spheres, 5000, generator)
    closest, counts, _, nearest = check_all_layouts_agree(run_shell, spheres, make_rays(origins, directions))

    from_centre = origins[:, None] - spheres.centres[None]
    square = (directions**2).sum(axis=1)[:, None]
    towards = -(from_centre * directions[:, None]).sum(axis=2)
    across = from_centre + (towards / square)[..., None] * directions[:, None]
    chord_squared = spheres.radii**2 - (across**2).sum(axis=2)
    half_chord = np.sqrt(np.maximum(chord_squared, 0) / square)
    t = np.stack((towards / square - half_chord, towards / square + half_chord), axis=2)
    t[chord_squared < 0] = np.inf
    speed = np.sqrt(square)[:, :, None]
    is_clear = (np.abs(chord_squared) > 1e-3 * spheres.radii).all(axis=1)
    is_clear &= (np.abs(t * speed) > 1e-3).all(axis=(1, 2)) & (np.abs(origins).max(axis=1) < 10)
    assert is_clear.mean() > 0.1
    ahead = np.where(t >= 0, t, np.inf)
    np.testing.assert_array_equal(counts[is_clear], np.isfinite(ahead).sum(axis=(1, 2))[is_clear])
    expected = ahead.min(axis=(1, 2))
    hit = is_clear & np.isfinite(expected)
    np.testing.assert_array_equal(closest["prim_id"][is_clear] == NO_PRIM, ~hit[is_clear])
    np.testing.assert_allclose(closest["t"][hit], expected[hit], rtol=1e-4)

    heights = np.abs(np.linalg.norm(from_centre, axis=2) - spheres.radii)
    chosen = heights[np.arange(len(origins)), nearest]
    assert (chosen <= heights.min(axis=1) + 1e-6 * (1 + np.abs(origins).max(axis=1))).all()


def test_limits_cut_both_ends(run_shell, make_rays):
    generator = np.random.default_rng(93)
    spheres = make_spheres(300, generator)
    origins, directions = sphere_rays(spheres, RAYS, generator)
    t_min, t_max = generator.uniform(0, 1, RAYS), generator.uniform(0.5, 2, RAYS)
    closest, *_ = check_all_layouts_agree(run_shell, spheres, make_rays(origins, directions, t_min, t_max))
    found = closest["prim_id"] != NO_PRIM
    assert 0.1 < found.mean() < 0.95
    assert (closest["t"][found] >= t_min[found].astype(np.float32)).all()
    assert (closest["t"][found] <= t_max[found].astype(np.float32)).all()


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_tree_that_is_one_leaf(run_shell, make_rays, count):
    generator = np.random.default_rng([94, count])
    spheres = spheres_as_on_device(generator.uniform(-0.5, 0.5, (count, 3)), 0.25)
    assert build_tree(spheres, "sah", None, BuildOptions(traversal_cost=100)).node_count == 1
    rays = make_rays(*sphere_rays(spheres, 3000, generator))
    closest, *_ = check_all_layouts_agree(run_shell, spheres, rays, traversal_cost=100)
    assert set(range(count)) <= set(closest["prim_id"].tolist())


@pytest.mark.parametrize("leaf_size", [1, 15, 255])
def test_leaves_of_any_size(run_shell, make_rays, leaf_size):
    generator = np.random.default_rng([95, leaf_size])
    spheres = make_spheres(600, generator)
    rays = make_rays(*sphere_rays(spheres, RAYS, generator))
    check_all_layouts_agree(
        run_shell, spheres, rays, leaf_size=leaf_size, traversal_cost=1000.0 if leaf_size > 1 else 1.0
    )


def test_equal_spheres_are_ordered_by_their_ids(run_shell, make_rays):
    spheres = spheres_as_on_device(np.zeros((20, 3)), 0.5)
    closest, counts, first, nearest = check_all_layouts_agree(
        run_shell, spheres, make_rays([[0.1, 0.2, -3], [0, 0, 0]], [[0, 0, 1], [0, 0, 1]])
    )
    assert (counts.tolist(), closest["prim_id"].tolist(), nearest.tolist()) == ([40, 20], [0, 0], [0, 0])
    assert first["prim_id"].tolist() == [list(range(6))] * 2
    assert (first["u"] == [[0], [1]]).all()

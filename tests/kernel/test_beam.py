"""A beam: it meets every box that any of its rays meets, and not everything else."""

import numpy as np
import pytest

from clbvh.structs import LAYOUT_WIDTHS, WIDE_NODES

from .test_slabs import LAYOUT_NAMES, clip_children

COUNT = 5_000

# Rays of a beam, and the answer for a beam without bounds; as in kernels/meet_by_beam.cl.
RAYS = 8
UNBOUNDED = 1 << 20


@pytest.fixture(scope="module", params=LAYOUT_NAMES)
def meet(request, run_lane_shell):
    """A function from rays, (n, RAYS), and boxes, (n, width, 3), to the bits of those that each beam meets."""
    layout = request.param
    width = LAYOUT_WIDTHS[layout]

    def run(rays, aabb_min, aabb_max):
        nodes = np.zeros(len(aabb_min), WIDE_NODES[width])
        nodes["aabb_min"], nodes["aabb_max"] = aabb_min.transpose(0, 2, 1), aabb_max.transpose(0, 2, 1)
        (met,) = run_lane_shell(layout, "meet_by_beam", [nodes, rays], [np.uint32])
        return met

    run.width = width
    return run


def make_beams(generator, spread, *, common_origin):
    """Rays of beams, (n, RAYS, 3) each; `spread` is how far apart those of a beam are."""
    shape = (COUNT, RAYS, 3)
    origins = generator.uniform(-2, 2, (COUNT, 1, 3))
    origins = origins + (0.0 if common_origin else spread) * generator.uniform(-1, 1, shape)
    directions = generator.normal(size=(COUNT, 1, 3))
    directions *= generator.choice([1, 0, 1e-30], (COUNT, 1, 3), p=[0.8, 0.15, 0.05])
    directions = directions + spread * generator.uniform(-1, 1, shape) * generator.choice([1, 0], (COUNT, 1, 3))
    directions[np.abs(directions).max(axis=2) < 1e-3] = [0, 0, 1]
    return origins.astype(np.float32), directions.astype(np.float32)


@pytest.mark.parametrize("common_origin", [True, False])
@pytest.mark.parametrize("spread", [0.0, 1e-4, 0.1, 1.0])
def test_what_a_ray_meets_its_beam_meets(meet, make_rays, spread, common_origin):
    generator = np.random.default_rng(33)
    corners = generator.uniform(-1, 1, (2, COUNT, meet.width, 3)).astype(np.float32)
    aabb_min, aabb_max = corners.min(axis=0), corners.max(axis=0)
    origins, directions = make_beams(generator, spread, common_origin=common_origin)
    t_min, t_max = np.sort(generator.uniform(0, 3, (2, COUNT, RAYS)).astype(np.float32), axis=0)
    rays = make_rays(origins.reshape(-1, 3), directions.reshape(-1, 3), t_min.reshape(-1), t_max.reshape(-1))

    met = meet(rays, aabb_min, aabb_max)

    is_unbounded = met == UNBOUNDED
    bits = (met[:, None] >> np.arange(meet.width)) & 1 == 1
    any_ray_meets = np.zeros_like(bits)
    for ray in range(RAYS):
        t_near, t_far = clip_children(origins[:, ray], directions[:, ray], aabb_min, aabb_max)
        t_near, t_far = np.maximum(t_near, t_min[:, ray, None]), np.minimum(t_far, t_max[:, ray, None])
        any_ray_meets |= t_near <= t_far
    assert 0.02 < any_ray_meets.mean() < 0.9
    np.testing.assert_array_equal(np.flatnonzero((any_ray_meets & ~bits).any(axis=1) & ~is_unbounded), [])
    if spread <= 1e-4:
        assert not is_unbounded.any()
        # A thin beam meets hardly more than its rays.
        assert (bits & ~any_ray_meets).mean() < 0.01 + spread * 100
    elif spread < 1.0:
        assert is_unbounded.mean() < 0.1
        assert bits.mean() < 0.9


def test_rays_without_an_interval_do_not_count(meet, make_rays):
    generator = np.random.default_rng(34)
    aabb_min, aabb_max = np.full((2, COUNT, meet.width, 3), 1.0, np.float32) * [[[[-1.0]]], [[[1.0]]]]
    origins, directions = make_beams(generator, 10.0, common_origin=False)
    origins[:, 0], directions[:, 0] = [5, 0, 0], [1, 0, 0]
    t_max = np.full((COUNT, RAYS), -1.0)
    # The only ray that is left runs away from the boxes; then there is none.
    t_max[: COUNT // 2, 0] = np.inf
    met = meet(make_rays(origins.reshape(-1, 3), directions.reshape(-1, 3), 0.0, t_max.reshape(-1)), aabb_min, aabb_max)
    assert not met.any()


def test_a_child_that_is_not_there_is_never_met(meet, make_rays):
    generator = np.random.default_rng(35)
    greatest = np.finfo(np.float32).max
    aabb_min, aabb_max = np.full((2, COUNT, meet.width, 3), greatest, np.float32) * [[[[1.0]]], [[[-1.0]]]]
    sizes = 10.0 ** generator.uniform(-37, 37, (COUNT, 1))
    aabb_min[:, 0], aabb_max[:, 0] = -sizes, sizes
    origins, directions = make_beams(generator, 0.1, common_origin=False)
    with np.errstate(over="ignore"):
        origins = (origins * sizes[:, None] * generator.choice([1, 1e3], (COUNT, 1, 1), p=[0.9, 0.1])).astype(
            np.float32
        )
    directions = directions * (10.0 ** generator.uniform(-10, 10, (COUNT, 1, 1))).astype(np.float32)
    met = meet(make_rays(origins.reshape(-1, 3), directions.reshape(-1, 3)), aabb_min, aabb_max)
    # A beam with a ray beyond float32 goes everywhere, and no box is asked.
    is_beyond = ~np.isfinite(origins).all(axis=(1, 2))
    assert is_beyond.any()
    assert (met[is_beyond] == UNBOUNDED).all()
    assert 0.15 < (met == 1).mean() < 1
    assert set(met.tolist()) == {0, 1, UNBOUNDED}

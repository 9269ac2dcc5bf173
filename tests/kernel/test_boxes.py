"""Boxes, alone, in lanes and by beams, against float64: never a false miss, and false hits only within the padding."""

import numpy as np
import pytest

from clbvh.tree_layouts import WIDE_LAYOUTS

from .boxes import BEAM_RAYS, LANES, UNBOUNDED, WAYS, clip, grow, meet, meet_alone, meet_by_beam, pad
from .programs import make_rays

pytestmark = pytest.mark.on_both

COUNT = 40_000


def make_boxes(generator, count, exponents):
    """(n, 2, 3) float32; a third of them are flat, some of these are lines and points."""
    corners = generator.uniform(-1, 1, (count, 2, 3)) * 10.0 ** generator.choice(exponents, (count, 1, 1))
    corners[:, 1] = np.where(generator.random((count, 3)) < 0.15, corners[:, 0], corners[:, 1])
    return np.sort(corners, axis=1).astype(np.float32)


def grazing_rays(generator, boxes):
    """At a corner, an edge or a face of each box, from near and far, or in a face; components may be nearly zero."""
    count = len(boxes)
    size = np.abs(boxes).max(axis=(1, 2))[:, None]
    origins = generator.uniform(-2, 2, (count, 3)) * size + generator.choice([0, 1, 100], (count, 1)) * size
    weights = generator.choice([0, 1, 0.5, 0.3], (count, 3), p=[0.35, 0.35, 0.15, 0.15])
    aims = boxes[:, 0] + weights * (boxes[:, 1].astype(np.float64) - boxes[:, 0])
    directions = aims - origins.astype(np.float32)
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    directions *= generator.choice([1, 0, 1e-30], (count, 3), p=[0.88, 0.09, 0.03])
    directions[np.abs(directions).max(axis=1) < 1e-3] = [0, 0, 1]
    # Half of the rays that are parallel to a face run in it.
    is_inside = (directions == 0) & (generator.random((count, 1)) < 0.5)
    origins = np.where(is_inside, aims, origins)
    t_min = np.where(generator.random(count) < 0.7, 0, 0.5)
    return make_rays(origins, directions, t_min, np.where(generator.random(count) < 0.7, np.inf, 1))


@pytest.mark.parametrize("seed", range(2))
def test_a_ray_that_grazes_a_box_meets_it_and_one_beyond_the_padding_does_not(call, seed):
    generator = np.random.default_rng([28, seed])
    boxes = make_boxes(generator, COUNT, [0, -1, -6])
    rays = grazing_rays(generator, boxes)
    t_near, t_far = clip(rays, boxes)
    padded_near, padded_far = clip(rays, pad(rays, boxes))
    grown_near, grown_far = clip(rays, grow(rays, boxes))
    is_met, is_padded, is_missed = t_near <= t_far, padded_near <= padded_far, grown_near > grown_far
    assert 0.2 < is_met.mean() < 0.9
    assert is_missed.mean() > 0.05
    for way in WAYS:
        found = meet(call, way, rays, boxes)
        np.testing.assert_array_equal(np.flatnonzero((is_met | is_padded) & ~found), [], way)
        if "beam" not in way:
            np.testing.assert_array_equal(np.flatnonzero(is_missed & found), [], way)
    _, t_nears = meet_alone(call, rays, boxes)
    assert (t_nears <= t_near)[is_met].all()
    assert (t_nears >= grown_near)[is_met].all()


def extreme_rays(generator, count):
    """From beyond what float32 has, with directions of any length; and boxes as large as float32 has them."""
    sizes = 10.0 ** generator.uniform(-37, 37, (count, 1))
    origins = sizes * generator.uniform(-2, 2, (count, 3))
    origins[generator.random((count, 3)) < 0.01] = np.inf
    origins[generator.random((count, 3)) < 0.01] = -np.inf
    directions = generator.normal(size=(count, 3)) * 10.0 ** generator.uniform(-10, 10, (count, 1))
    directions[generator.random((count, 3)) < 0.2] = 0
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    return make_rays(origins, directions), (sizes[..., None] * np.outer([-1, 1], np.ones(3))).astype(np.float32)


def test_a_child_that_is_not_there_is_never_met(call):
    rays, boxes = extreme_rays(np.random.default_rng(29), COUNT)
    for way in LANES:
        assert 0.2 < meet(call, way, rays, boxes).mean() < 1  # `meet` looks at the other children
    beams = rays.reshape(-1, BEAM_RAYS)
    far = np.full((len(rays), 2, 3), np.finfo(np.float32).max)
    assert not np.isnan(meet_alone(call, rays, far)[1]).any()
    for layout in WIDE_LAYOUTS:
        met = meet_by_beam(call, layout, beams, boxes[::BEAM_RAYS])
        # A beam with a ray beyond float32 goes everywhere, and no box is asked.
        is_beyond = ~np.isfinite(beams["origin"]).all(axis=(1, 2))
        assert (met[is_beyond] == UNBOUNDED).all()


def make_beams(generator, count, spread, *, common_origin):
    """Origins and directions of the rays of beams; `spread` is how far apart those of a beam are."""
    shape = (count, BEAM_RAYS, 3)
    origins = generator.uniform(-1.2, 1.2, (count, 1, 3))
    origins = origins + (0 if common_origin else spread) * generator.uniform(-1, 1, shape)
    directions = generator.normal(size=(count, 1, 3))
    directions *= generator.choice([1, 0, 1e-30], (count, 1, 3), p=[0.8, 0.15, 0.05])
    directions = directions + spread * generator.uniform(-1, 1, shape) * generator.choice([1, 0], (count, 1, 3))
    directions[np.abs(directions).max(axis=2) < 1e-3] = [0, 0, 1]
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
@pytest.mark.parametrize("spread", [0, 1e-4, 0.1, 1])
def test_what_a_ray_meets_its_beam_meets(call, layout, spread):
    generator = np.random.default_rng(33)
    boxes = make_boxes(generator, 20_000, [0])
    for common_origin in (True, False):
        limits = np.sort(generator.uniform(0, 3, (2, 20_000 * BEAM_RAYS)), axis=0)
        rays = make_rays(*make_beams(generator, 20_000, spread, common_origin=common_origin), *limits)
        met = meet_by_beam(call, layout, rays.reshape(-1, BEAM_RAYS), boxes)
        t_near, t_far = clip(rays, np.repeat(boxes, BEAM_RAYS, axis=0))
        is_met = (t_near <= t_far).reshape(-1, BEAM_RAYS).any(axis=1)
        assert 0.02 < is_met.mean() < 0.9
        np.testing.assert_array_equal(np.flatnonzero(is_met & (met == 0)), [])
        if spread <= 1e-4:
            assert not (met == UNBOUNDED).any()
            # A thin beam meets hardly more than its rays.
            assert ((met == 1) & ~is_met).mean() < 0.01 + spread * 100
        elif spread < 1:
            assert (met == UNBOUNDED).mean() < 0.1
            assert (met == 1).mean() < 0.9


@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
def test_rays_without_an_interval_do_not_widen_a_beam(call, layout):
    origins, directions = make_beams(np.random.default_rng(34), 1000, 10, common_origin=False)
    beams = make_rays(origins, directions, 0, -1).reshape(-1, BEAM_RAYS)
    # The only ray that is left runs away from the boxes; then there is none.
    beams[:500, 0] = make_rays([5, 0, 0], [1, 0, 0])[0]
    assert not meet_by_beam(call, layout, beams, np.tile([[[-1.0]], [[1.0]]], (1000, 1, 3)).reshape(-1, 2, 3)).any()

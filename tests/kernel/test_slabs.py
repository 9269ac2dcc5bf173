"""The slab test in lanes against float64: never a false miss, wherever the ray begins."""

import numpy as np
import pytest

from clbvh.structs import LAYOUT_WIDTHS, WIDE_NODES

from ..rays import AXES
from .test_aabb import clip, grow, pad

COUNT = 20_000
LAYOUT_NAMES = [layout for layout, width in LAYOUT_WIDTHS.items() if width in WIDE_NODES]


@pytest.fixture(scope="module", params=LAYOUT_NAMES)
def meet(request, run_lane_shell, make_rays):
    """A function from rays and each one's boxes, (n, width, 3), to which of these it meets."""
    layout = request.param
    width = LAYOUT_WIDTHS[layout]

    def run(origins, directions, aabb_min, aabb_max, *, portable=False):
        nodes = np.zeros(len(origins), WIDE_NODES[width])
        nodes["aabb_min"], nodes["aabb_max"] = aabb_min.transpose(0, 2, 1), aabb_max.transpose(0, 2, 1)
        inputs = [make_rays(origins, directions), nodes]
        (met,) = run_lane_shell(layout, "meet_children", inputs, [np.uint32], portable=portable)
        return (met[:, None] >> np.arange(width)) & 1 == 1

    run.width = width
    return run


def clip_children(origins, directions, aabb_min, aabb_max):
    """Where each ray enters and leaves each of its boxes, in float64."""
    width = aabb_min.shape[1]
    rows = [np.repeat(array, width, axis=0) for array in (origins, directions)]
    t_near, t_far = clip(*rows, aabb_min.reshape(-1, 3), aabb_max.reshape(-1, 3), 0, np.inf)
    return t_near.reshape(-1, width), t_far.reshape(-1, width)


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("away", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_ray_that_grazes_a_box_meets_it(meet, seed, away, portable):
    generator = np.random.default_rng([28, seed])
    corners = generator.uniform(-1, 1, (2, COUNT, meet.width, 3)).astype(np.float32)
    aabb_min, aabb_max = corners.min(axis=0), corners.max(axis=0)
    origins = generator.uniform(-2, 2, (COUNT, 3)) + away * generator.uniform(-1, 1, (COUNT, 3))
    origins = origins.astype(np.float32)
    # At a corner, an edge or a face of the first box; some have a component that is zero, or nearly so.
    weights = generator.choice([0.0, 1.0, 0.5], (COUNT, 3), p=[0.4, 0.4, 0.2])
    aims = aabb_min[:, 0] + weights * (aabb_max[:, 0].astype(np.float64) - aabb_min[:, 0])
    directions = aims - origins
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    directions *= generator.choice([1.0, 0.0, 1e-30], (COUNT, 3), p=[0.9, 0.07, 0.03])
    directions = directions.astype(np.float32)
    directions[np.abs(directions).max(axis=1) < 1e-3] = [0, 0, 1]

    is_met = meet(origins, directions, aabb_min, aabb_max, portable=portable)

    t_near, t_far = clip_children(origins, directions, aabb_min, aabb_max)
    assert 0.1 < (t_near <= t_far).mean() < 0.9
    np.testing.assert_array_equal(np.flatnonzero((t_near <= t_far) & ~is_met), [])
    # Nor does one that is beside it by almost the padding.
    padded = pad(origins[:, None], directions[:, None], aabb_min, aabb_max)
    t_near, t_far = clip_children(origins, directions, *padded)
    np.testing.assert_array_equal(np.flatnonzero((t_near <= t_far) & ~is_met), [])
    # Nothing beyond the padding is met.
    t_near, t_far = clip_children(origins, directions, *grow(origins[:, None], aabb_min, aabb_max))
    np.testing.assert_array_equal(np.flatnonzero((t_near > t_far) & is_met), [])


@pytest.mark.parametrize("direction", AXES, ids=["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_ray_in_a_face_meets_the_box_and_one_beside_does_not(meet, direction):
    # The origin is 0 on the axes across, where a plane through it is at distance 0 whatever the inverse is.
    low, high = np.full((1, meet.width, 3), -1.0), np.full((1, meet.width, 3), 1.0)
    across = [axis for axis in range(3) if direction[axis] == 0]
    for lane in range(meet.width):
        # In a face, beside it, in an edge, and inside.
        for axis in across[: [1, 1, 2, 0][lane % 4]]:
            (low if lane < 2 else high)[0, lane, axis] = [0.0, 1e-6, 0.0, 1.0][lane % 4]
    boxes = [side.astype(np.float32) for side in (low, high)]
    is_met = meet((-3 * direction).astype(np.float32)[None], direction[None], *boxes)
    assert is_met[0].tolist() == [lane % 4 != 1 or lane > 1 for lane in range(meet.width)]


def test_a_child_that_is_not_there_is_never_met(meet):
    generator = np.random.default_rng(29)
    greatest = np.finfo(np.float32).max
    aabb_min, aabb_max = np.full((2, COUNT, meet.width, 3), greatest, np.float32) * [[[[1.0]]], [[[-1.0]]]]
    # One child is there, and may be as large as float32 has it.
    sizes = 10.0 ** generator.uniform(-37, 37, (COUNT, 1))
    aabb_min[:, 0], aabb_max[:, 0] = -sizes, sizes
    origins = sizes * generator.uniform(-2, 2, (COUNT, 3))
    # Beyond float32, as the host passes on what is too far away.
    origins[generator.random((COUNT, 3)) < 0.01] = np.inf
    origins[generator.random((COUNT, 3)) < 0.01] = -np.inf
    directions = generator.normal(size=(COUNT, 3)) * 10.0 ** generator.uniform(-10, 10, (COUNT, 1))
    directions[generator.random((COUNT, 3)) < 0.2] = 0
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    is_met = meet(origins, directions, aabb_min, aabb_max)
    assert 0.2 < is_met[:, 0].mean() < 1
    assert not is_met[:, 1:].any()

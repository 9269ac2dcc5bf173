"""The slab test against float64: never a false miss, and false hits only within the padding."""

import numpy as np
import pytest

from ..rays import AXES

# Coordinates of a mesh are at most 1. The device meets no box that misses the ray by more than this share of 1 and the
# origin's largest coordinate: 14 roundings and 28 of padding, 8 of the test itself, and little more for the slopes that
# count as zero.
LARGEST = 1.0
PADDING = 51 * 2.0**-24


@pytest.fixture(scope="module")
def meet(run_shell, make_rays):
    """A function from rays and boxes to (is_met, t_nears)."""

    def run(origins, directions, aabb_min, aabb_max, t_min=0.0, t_max=np.inf):
        arrays = [np.asarray(array, np.float32) for array in (origins, directions, aabb_min, aabb_max)]
        origins, directions, aabb_min, aabb_max = np.broadcast_arrays(*map(np.atleast_2d, arrays))
        rays = make_rays(origins, directions, t_min, t_max)
        boxes = np.concatenate((aabb_min, aabb_max), axis=1)
        is_met, t_nears = run_shell("meet_boxes", [rays, boxes], [np.int32, np.float32])
        return is_met.astype(bool), t_nears

    return run


def pad(origins, directions, aabb_min, aabb_max):
    """The boxes, with the padding that docs/internals/padding.md derives, but for what the slab test may round."""
    size, reach = np.abs(directions).astype(np.float64), np.abs(origins).astype(np.float64) + LARGEST
    longest = size.argmax(axis=-1)[..., None]
    slope = size / np.take_along_axis(size, longest, axis=-1)
    padding = 2.0**-24 * ((13 - 8) * reach + 27 * slope * np.take_along_axis(reach, longest, axis=-1))
    return aabb_min - padding, aabb_max + padding


def grow(origins, aabb_min, aabb_max):
    """The boxes, padded by what the device adds at most."""
    padding = PADDING * (np.abs(origins).astype(np.float64).max(axis=-1, keepdims=True) + LARGEST)
    return aabb_min - padding, aabb_max + padding


def clip(origins, directions, aabb_min, aabb_max, t_min, t_max):
    """The oracle: where the ray enters and leaves, in float64; inside a slab is closed."""
    origins, directions, aabb_min, aabb_max = (
        np.asarray(array, np.float64) for array in (origins, directions, aabb_min, aabb_max)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        to_min, to_max = (aabb_min - origins) / directions, (aabb_max - origins) / directions
    near, far = np.minimum(to_min, to_max), np.maximum(to_min, to_max)
    parallel = directions == 0
    inside = (aabb_min <= origins) & (origins <= aabb_max)
    near = np.where(parallel, np.where(inside, -np.inf, np.inf), near)
    far = np.where(parallel, np.where(inside, np.inf, -np.inf), far)
    return np.maximum(near.max(axis=1), t_min), np.minimum(far.min(axis=1), t_max)


BOX = (np.array([1.0, -2.0, 3.0]) / 8, np.array([2.0, -1.0, 5.0]) / 8)
CENTRE = (BOX[0] + BOX[1]) / 2
AXIS_IDS = ["+x", "-x", "+y", "-y", "+z", "-z"]


def across(direction):
    """The two axes that a ray along an axis is not parallel to."""
    return [axis for axis in range(3) if direction[axis] == 0]


@pytest.mark.parametrize("direction", AXES, ids=AXIS_IDS)
class TestAxisParallel:
    def test_through_the_middle(self, meet, direction):
        origin = CENTRE - 10 * direction
        is_met, t_nears = meet(origin, direction, *BOX)
        assert is_met.all()
        axis = int(np.argmax(np.abs(direction)))
        expected = 10 - (BOX[1] - BOX[0])[axis] / 2
        assert expected - 12 * PADDING < t_nears[0] <= expected

    @pytest.mark.parametrize("side", [0, 1], ids=["min", "max"])
    @pytest.mark.parametrize("which", [0, 1])
    def test_in_a_face_is_inside_and_beside_it_is_not(self, meet, direction, which, side):
        axis = across(direction)[which]
        origin = (CENTRE - 10 * direction).astype(np.float32)
        origin[axis] = BOX[side][axis]
        outside = origin.copy()
        outside[axis] += (1 if side else -1) * 12 * PADDING
        is_met, _ = meet([origin, outside], direction, *BOX)
        assert is_met.tolist() == [True, False]

    @pytest.mark.parametrize("corner", [(0, 0), (0, 1), (1, 0), (1, 1)])
    def test_along_an_edge(self, meet, direction, corner):
        origin = CENTRE - 10 * direction
        for axis, side in zip(across(direction), corner, strict=True):
            origin[axis] = BOX[side][axis]
        is_met, t_nears = meet(origin, direction, *BOX)
        assert is_met.all()
        assert np.isfinite(t_nears).all()

    def test_from_inside(self, meet, direction):
        is_met, t_nears = meet(CENTRE, direction, *BOX)
        assert is_met.all()
        assert t_nears[0] == 0

    def test_from_a_face(self, meet, direction):
        axis = int(np.argmax(np.abs(direction)))
        origins = np.stack((CENTRE, CENTRE))
        origins[:, axis] = BOX[0][axis], BOX[1][axis]
        is_met, t_nears = meet(origins, direction, *BOX)
        assert is_met.all()
        assert (t_nears == 0).all()

    def test_behind(self, meet, direction):
        is_met, _ = meet(CENTRE + 10 * direction, direction, *BOX)
        assert not is_met.any()

    def test_a_point_is_a_box(self, meet, direction):
        on, beside = CENTRE - 10 * direction, CENTRE - 10 * direction
        beside[across(direction)[0]] += 1e-3
        is_met, t_nears = meet([on, beside], direction, CENTRE, CENTRE)
        assert is_met.tolist() == [True, False]
        assert 10 - 12 * PADDING < t_nears[0] <= 10


def test_limits_are_part_of_the_ray(meet):
    # The box is entered at 3 and left at 5, eighths of a unit.
    t_min = [0, 3, 4, 5, 5.001, 6, np.inf, 0, 0, 0, 0, 4, 0]
    t_max = [np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, 3, 2.999, 2, -1, 4, -np.inf]
    expected = [True, True, True, True, False, False, False, True, False, False, False, True, False]
    is_met, t_nears = meet([[1.5 / 8, -1.5 / 8, 0]] * len(t_min), [0, 0, 1 / 8], *BOX, t_min, t_max)
    assert is_met.tolist() == expected
    assert 3 - 8 * PADDING < t_nears[0] <= 3
    assert t_nears[[2, 3, 11]].tolist() == [4, 5, 4]


@pytest.mark.parametrize("unbounded", [np.inf, np.finfo(np.float32).max])
def test_boxes_without_end(meet, unbounded):
    directions = np.concatenate((AXES, [[1, 2, -3], [-1e-20, 1, 1e-20]]))
    is_met, t_nears = meet([5, 6, 7], directions, [-unbounded] * 3, [unbounded] * 3)
    assert is_met.all()
    assert (t_nears == 0).all()


def test_the_box_that_stands_for_no_child_ends_no_search(meet):
    # The lone leaf's second box, see tree/layouts.py: whatever is answered, no answer may be NaN.
    far = [np.finfo(np.float32).max] * 3
    directions = np.concatenate((AXES, [[1, 2, 3], [1, 1, 1], [-1, -2, -3]]))
    _, t_nears = meet([0, 0, 0], directions, far, far)
    assert not np.isnan(t_nears).any()


@pytest.mark.parametrize("axis", range(3))
def test_a_gap_above_rounding_is_seen(meet, axis):
    # The ray enters one slab at t = 1 and leaves another a little before that.
    gaps = np.array([0, 1e-7, 2e-6, 2e-5, 1e-3])
    upper = np.roll(np.stack((np.full(5, 1), 0.5 - gaps, np.full(5, 1)), axis=1), axis, axis=1)
    is_met, _ = meet([0, 0, 0], np.roll([0.5, 0.5, 0], axis), np.roll([0.5, -1, -1], axis), upper)
    assert is_met.tolist() == [True, True, True, False, False]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("spread", [0, 6], ids=["alike", "many-sizes"])
def test_random_rays_never_miss_falsely(meet, seed, spread):
    generator = np.random.default_rng([5, seed])
    count = 50_000
    scale = 10.0 ** generator.uniform(-spread, 0, (count, 1)) if spread else 1.0
    corners = (generator.uniform(-1, 1, (2, count, 3)) * scale).astype(np.float32)
    # A third of the boxes are flat, some of these are lines and points.
    corners[1] = np.where(generator.random((count, 3)) < 0.15, corners[0], corners[1])
    aabb_min, aabb_max = corners.min(axis=0), corners.max(axis=0)
    origins = (generator.uniform(-2, 2, (count, 3)) * scale).astype(np.float32)
    # Aimed at a corner, an edge or a face of the box, so that half of the rays only graze it.
    weights = generator.choice([0.0, 1.0, 0.5, 0.3], (count, 3), p=[0.35, 0.35, 0.15, 0.15])
    directions = (aabb_min + weights * (aabb_max.astype(np.float64) - aabb_min) - origins).astype(np.float32)
    directions[generator.random((count, 3)) < 0.1] = 0
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    t_min = np.where(generator.random(count) < 0.5, 0, 0.5)
    t_max = np.where(generator.random(count) < 0.5, np.inf, 1).astype(np.float32)

    t_near, t_far = clip(origins, directions, aabb_min, aabb_max, t_min, t_max)
    is_met, t_nears = meet(origins, directions, aabb_min, aabb_max, t_min, t_max)

    met = t_near <= t_far
    grown_near, grown_far = clip(origins, directions, *grow(origins, aabb_min, aabb_max), t_min, t_max)
    missed = grown_far < grown_near
    assert 0.2 < met.mean() < 0.9
    assert missed.mean() > 0.05
    padded_near, padded_far = clip(origins, directions, *pad(origins, directions, aabb_min, aabb_max), t_min, t_max)
    np.testing.assert_array_equal(np.flatnonzero((padded_near <= padded_far) & ~is_met), [])
    np.testing.assert_array_equal(np.flatnonzero(missed & is_met), [])
    assert (t_nears <= t_near)[met].all()
    assert (t_nears >= grown_near)[met].all()

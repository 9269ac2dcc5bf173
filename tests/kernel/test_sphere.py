"""The sphere test: formula, limits, starts inside, touching rays, sizes, and small spheres far away."""

import numpy as np
import pytest

from clbvh.structs import HIT, LAYOUTS, NO_PRIM, SPHERE

from ..profiles import seeds
from ..rays import as_float32
from ..spheres import make_spheres

COUNT = 40_000
UNIT_ROUNDOFF = 2.0**-24
ENTERS, LEAVES = 0, 1


@pytest.fixture(scope="module")
def cross(run_shell, make_rays):
    """A function from rays and spheres, pair by pair, to crossings in order, the closest one, and their number."""

    def run(origins, directions, centres, radii, prim_ids=0, t_min=0.0, t_max=np.inf):
        rays = make_rays(origins, directions, t_min, t_max)
        spheres = np.zeros(len(rays), SPHERE)
        spheres["centre"], spheres["radius"], spheres["prim_id"] = centres, radii, prim_ids
        hits, closest, counts = run_shell(
            "cross_spheres", [rays, spheres], [(HIT, (2,)), HIT, np.int32], "sphere_shells",
            {"LAYOUT": LAYOUTS["brute"], "STACK_SIZE": 1, "HAS_SPHERES": 1},
        )  # fmt: skip
        # All queries agree.
        np.testing.assert_array_equal((hits["prim_id"] != NO_PRIM).sum(axis=1), counts)
        np.testing.assert_array_equal(closest, hits[:, 0])
        assert (hits["v"] == 0).all()
        return hits, counts

    return run


def measure(origins, directions, centres, t):
    """The distance of the ray's point from the centre in float64."""
    return np.linalg.norm(origins + t[:, None] * directions - centres, axis=1)


def find_middle(origins, directions, centres):
    """The t of the line's point that is closest to the centre."""
    return ((centres - origins) * directions).sum(axis=1) / (directions**2).sum(axis=1)


@pytest.mark.parametrize("seed", seeds(2))
def test_crossings_are_those_of_the_formula(cross, seed):
    generator = np.random.default_rng([90, seed])
    spheres = make_spheres(COUNT, generator)
    centres, radii = spheres.centres, spheres.radii
    # From anywhere or from inside, to anywhere in the box of a sphere.
    origins = generator.normal(size=(COUNT, 3)) * 10.0 ** generator.uniform(-2, 2, (COUNT, 1))
    inner = centres + radii[:, None] * generator.uniform(-0.6, 0.6, (COUNT, 3))
    origins = as_float32(np.where(generator.random((COUNT, 1)) < 0.3, inner, origins))
    targets = centres + radii[:, None] * generator.uniform(-1.2, 1.2, (COUNT, 3))
    directions = as_float32((targets - origins) * 10.0 ** generator.uniform(-3, 3, (COUNT, 1)))
    hits, counts = cross(origins, directions, centres, radii, prim_ids=np.arange(COUNT))

    # By docs/internals/padding.md a crossing is a point of a sphere that is this much larger or smaller.
    slack = 64 * UNIT_ROUNDOFF * (np.abs(origins).max(axis=1) + 1) * 2
    middle = find_middle(origins, directions, centres)
    passes_at = measure(origins, directions, centres, middle)
    starts_at = np.linalg.norm(origins - centres, axis=1)
    is_ahead = (middle > 0) | (starts_at < radii)
    starts_inside = starts_at < radii
    expected = np.where((passes_at < radii) & is_ahead, np.where(starts_inside, 1, 2), 0)
    is_clear = (np.abs(passes_at - radii) > slack) & (np.abs(starts_at - radii) > slack)
    assert is_clear.mean() > 0.9
    np.testing.assert_array_equal(counts[is_clear], expected[is_clear])
    assert all((counts == number).mean() > 0.05 for number in (0, 1, 2))

    for slot in (0, 1):
        found = hits[:, slot]["prim_id"] != NO_PRIM
        t, end = hits[found, slot]["t"].astype(np.float64), hits[found, slot]["u"]
        rows = [values[found] for values in (origins, directions, centres)]
        assert (np.abs(measure(*rows, t) - radii[found]) <= slack[found]).all()
        np.testing.assert_array_equal(hits[found, slot]["prim_id"], np.flatnonzero(found))
        # The first of two enters, and the last of all leaves.
        np.testing.assert_array_equal(end, np.where((slot == 0) & (counts[found] == 2), ENTERS, LEAVES))
    both = counts == 2
    assert (hits[both, 0]["t"] <= hits[both, 1]["t"]).all()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("slant", [0.0, 0.25])
def test_a_ray_through_the_centre(cross, axis, sign, slant):
    direction = np.roll([1.0, slant, -slant], axis) * sign
    speed = np.linalg.norm(direction)
    hits, counts = cross([-4 * direction], [direction], [[0, 0, 0]], 0.5)
    assert counts.tolist() == [2]
    assert hits[0]["u"].tolist() == [ENTERS, LEAVES]
    assert hits[0]["t"] == pytest.approx([4 - 0.5 / speed, 4 + 0.5 / speed], abs=1e-6)


@pytest.mark.parametrize(
    ("t_min", "t_max", "expected"),
    [
        (0, np.inf, [3.5, 4.5]),
        (3.5, 4.5, [3.5, 4.5]),
        (3.75, np.inf, [4.5]),
        (0, 4, [3.5]),
        (3.75, 4.25, []),
        (5, np.inf, []),
        (0, 3, []),
        (4, 3, []),
        (np.nan, np.inf, []),
    ],
)
def test_limits_cut_both_ends(cross, t_min, t_max, expected):
    hits, counts = cross([[0, 0, -4]], [[0, 0, 1]], [[0, 0, 0]], 0.5, t_min=t_min, t_max=t_max)
    assert counts.tolist() == [len(expected)]
    assert hits[0]["t"][: len(expected)].tolist() == expected
    assert hits[0]["u"][: len(expected)].tolist() == [{3.5: ENTERS, 4.5: LEAVES}[t] for t in expected]


@pytest.mark.parametrize("place", [0.0, 0.25, -0.4999])
def test_a_ray_that_starts_inside_leaves(cross, place):
    hits, counts = cross([[place, 0, 0]], [[1, 0, 0]], [[0, 0, 0]], 0.5)
    assert (counts.tolist(), hits[0]["u"][0]) == ([1], LEAVES)
    assert hits[0]["t"][0] == pytest.approx(0.5 - place, abs=1e-7)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("along", [-1, 1])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("radius", [0.5, 2.0**-40, 2.0**-100])
def test_a_ray_that_touches_crosses_twice_in_one_point(cross, axis, along, side, radius):
    direction, offset = np.roll([0, 0, along], axis), np.roll([side * radius, 0, 0], axis)
    beside = offset * (1 + 2.0**-20)
    hits, counts = cross(
        np.array([offset, offset * (1 - 2.0**-20), beside]) - 2 * direction, [direction] * 3, [[0, 0, 0]] * 3, radius
    )
    assert counts.tolist() == [2, 2, 0]
    assert hits[0]["t"].tolist() == [2, 2]
    assert hits[0]["u"].tolist() == [ENTERS, LEAVES]


@pytest.mark.parametrize("distance", [1e2, 1e5, 1e8, 1e15])
@pytest.mark.parametrize("radius", [1e-1, 1e-4, 1e-12, 1e-30])
@pytest.mark.parametrize("axis", range(3))
def test_small_spheres_far_away_are_hit_to_their_rim(cross, distance, radius, axis):
    """The textbook's discriminant has lost all of these radii beside the square of the distance."""
    shares = np.array([0.0, 0.5, 0.999, 1.001, 2.0, 1e3])
    offsets = np.zeros((len(shares), 3))
    offsets[:, 1] = -shares * radius
    origins = np.roll(np.add(offsets, [distance, 0, 0]), axis, axis=1)
    hits, counts = cross(origins, np.roll([[-1.0, 0, 0]] * len(shares), axis, axis=1), np.zeros((6, 3)), radius)
    assert counts.tolist() == [2, 2, 2, 0, 0, 0]
    # Where float32 has one t for both, the ray still enters first.
    assert (hits[:3]["u"] == [ENTERS, LEAVES]).all()
    np.testing.assert_allclose(hits[:3]["t"], distance, rtol=1e-6, atol=radius)


def test_spheres_behind_and_rays_that_are_no_rays_cross_nothing(cross):
    origins = [[0, 0, 4], [np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -4], [3e38, 3e38, -3e38]]
    directions = [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, np.nan, 1], [1, 1, 1]]
    _, counts = cross(origins, directions, np.zeros((5, 3)), [0.5, 0.5, 0.5, 0.5, 1e-38])
    assert counts.tolist() == [0] * 5
    _, counts = cross([[0, 0, -4]], [[0, 0, 1]], [[np.nan] * 3], np.nan)
    assert counts.tolist() == [0]

"""The sphere test: formula, limits, starts inside, touching rays, sizes, and small spheres far away."""

import numpy as np
import pytest

from clbvh.kinds import SPHERE, SPHERES
from clbvh.structs import NO_PRIM

from ..profiles import seeds
from ..rays import as_float32
from ..spheres import make_spheres
from .programs import make_rays

pytestmark = pytest.mark.on_both

COUNT = 40_000
UNIT_ROUNDOFF = 2.0**-24
ENTERS, LEAVES = 0, 1
DEFINES = {"KINDS": SPHERES.bit}

CROSS = """
    const ray_t unpacked = unpack_ray(ray);
    const crossing_t none = no_crossing();
    hits[0] = hits[1] = as_hit(&none);
    search_t first = make_search(2, hits);
    intersect_sphere(sphere, 0, &unpacked, &first, QUERY_FIRST);
    sort_hits(&first);
    search_t nearest = make_search(1, 0);
    intersect_sphere(sphere, 0, &unpacked, &nearest, QUERY_CLOSEST);
    closest = as_hit(&nearest.nearest);
    search_t all = make_search(INT_MAX, 0);
    intersect_sphere(sphere, 0, &unpacked, &all, QUERY_COUNT);
    number = all.count;
"""


def make_records(centres, radii, prim_ids=0):
    """An array of `SPHERE`."""
    spheres = np.zeros(len(centres), SPHERE)
    spheres["centre"], spheres["radius"], spheres["prim_id"] = centres, radii, prim_ids
    return spheres


def cross_spheres(call, rays, spheres):
    """The crossings of ray i with sphere i in order, (n, 2), misses behind them; and their number."""
    outputs = "hit_t hits[2], hit_t closest, int number"
    hits, closest, counts = call("spheres/single.cl", CROSS, outputs, ray=rays, sphere=spheres, defines=DEFINES)
    # All queries agree.
    np.testing.assert_array_equal((hits["prim_id"] != NO_PRIM).sum(axis=1), counts)
    np.testing.assert_array_equal(closest, hits[:, 0])
    assert (hits["v"] == 0).all()
    return hits, counts


@pytest.fixture
def cross(call):
    """A function from rays and spheres, pair by pair, to crossings in order and their number."""

    def run(origins, directions, centres, radii, prim_ids=0, **limits):
        rays = make_rays(origins, directions, **limits)
        return cross_spheres(call, rays, make_records(np.broadcast_to(centres, (len(rays), 3)), radii, prim_ids))

    return run


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
    middle = ((centres - origins) * directions).sum(axis=1) / (directions**2).sum(axis=1)
    passes_at = np.linalg.norm(origins + middle[:, None] * directions - centres, axis=1)
    starts_at = np.linalg.norm(origins - centres, axis=1)
    is_ahead = (middle > 0) | (starts_at < radii)
    expected = np.where((passes_at < radii) & is_ahead, np.where(starts_at < radii, 1, 2), 0)
    is_clear = (np.abs(passes_at - radii) > slack) & (np.abs(starts_at - radii) > slack)
    assert is_clear.mean() > 0.9
    np.testing.assert_array_equal(counts[is_clear], expected[is_clear])
    assert (np.bincount(counts) > 0.05 * COUNT).all()

    for slot in (0, 1):
        found = hits[:, slot]["prim_id"] != NO_PRIM
        points = (origins + hits[:, slot, None]["t"].astype(np.float64) * directions - centres)[found]
        assert (np.abs(np.linalg.norm(points, axis=1) - radii[found]) <= slack[found]).all()
        np.testing.assert_array_equal(hits[found, slot]["prim_id"], np.flatnonzero(found))
        # The first of two enters, and the last of all leaves.
        end = np.where((slot == 0) & (counts[found] == 2), ENTERS, LEAVES)
        np.testing.assert_array_equal(hits[found, slot]["u"], end)
    assert (hits["t"][:, 0] <= hits["t"][:, 1])[counts == 2].all()


def test_limits_cut_both_ends(cross):
    for t_min, t_max, expected in [
        (0, np.inf, [3.5, 4.5]), (3.5, 4.5, [3.5, 4.5]), (3.75, np.inf, [4.5]), (0, 4, [3.5]), (3.75, 4.25, []),
        (5, np.inf, []), (0, 3, []), (4, 3, []), (np.nan, np.inf, []),
    ]:  # fmt: skip
        hits, counts = cross([[0, 0, -4]], [[0, 0, 1]], [0, 0, 0], 0.5, t_min=t_min, t_max=t_max)
        assert hits[0]["t"][: counts[0]].tolist() == expected, (t_min, t_max)
        assert hits[0]["u"][: counts[0]].tolist() == [{3.5: ENTERS, 4.5: LEAVES}[t] for t in expected]


@pytest.mark.parametrize("radius", [0.5, 2.0**-40, 2.0**-100])
def test_a_ray_that_touches_crosses_twice_in_one_point(cross, radius):
    for axis, along, side in np.ndindex(3, 2, 2):
        direction, offset = np.roll([0, 0, 2 * along - 1], axis), np.roll([(2 * side - 1) * radius, 0, 0], axis)
        shares = np.array([[1], [1 - 2.0**-20], [1 + 2.0**-20]])
        hits, counts = cross(shares * offset - 2 * direction, direction, [0, 0, 0], radius)
        assert counts.tolist() == [2, 2, 0]
        assert hits[0][["t", "u"]].tolist() == [(2, ENTERS), (2, LEAVES)]


@pytest.mark.parametrize("distance", [1e2, 1e5, 1e8, 1e15])
@pytest.mark.parametrize("radius", [1e-1, 1e-4, 1e-12, 1e-30])
def test_small_spheres_far_away_are_hit_to_their_rim(cross, distance, radius):
    """The textbook's discriminant has lost all of these radii beside the square of the distance."""
    shares = np.array([0.0, 0.5, 0.999, 1.001, 2.0, 1e3])
    for axis in range(3):
        origins = np.stack((np.full(6, distance), -shares * radius, np.zeros(6)), axis=1)
        hits, counts = cross(np.roll(origins, axis, axis=1), np.roll([-1.0, 0, 0], axis), [0, 0, 0], radius)
        assert counts.tolist() == [2, 2, 2, 0, 0, 0]
        # Where float32 has one t for both, the ray still enters first.
        assert (hits[:3]["u"] == [ENTERS, LEAVES]).all()
        np.testing.assert_allclose(hits[:3]["t"], distance, rtol=1e-6, atol=radius)


def test_spheres_behind_and_rays_that_are_no_rays_cross_nothing(cross):
    origins = [[0, 0, 4], [np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -4], [3e38, 3e38, -3e38], [0, 0, -4]]
    directions = [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, np.nan, 1], [1, 1, 1], [0, 0, 1]]
    _, counts = cross(origins, directions, [0, 0, 0], [0.5, 0.5, 0.5, 0.5, 1e-38, np.nan])
    assert counts.tolist() == [0] * 6

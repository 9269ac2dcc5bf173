"""The triangle test: formula, limits, ties, degenerate input, scales, and rays that run in the triangle's plane."""

from fractions import Fraction

import numpy as np
import pytest

from clbvh.structs import HIT, NO_PRIM, TRIANGLE

from ..rays import aim, as_float32

MISS = (np.inf, 0.0, 0.0, NO_PRIM)


@pytest.fixture(scope="module")
def cross(run_shell, make_rays):
    """A function from rays and triangles, pair by pair, to hits."""

    def run(origins, directions, corners, prim_ids=0, earlier=MISS, t_min=0.0, t_max=np.inf):
        origins, directions = np.broadcast_arrays(
            np.atleast_2d(origins).astype(np.float32), np.atleast_2d(directions).astype(np.float32)
        )
        triangles = np.empty(len(origins), TRIANGLE)
        corners = np.broadcast_to(corners, (len(origins), 3, 3))
        for index, name in enumerate("abc"):
            triangles[name] = corners[:, index]
        triangles["prim_id"] = prim_ids
        before = np.empty(len(origins), HIT)
        before[:] = earlier
        rays = make_rays(origins, directions, t_min, t_max)
        hits, triangle_indices = run_shell("cross_triangles", [rays, triangles, before], [HIT, np.int32])
        replaced = hits != before
        np.testing.assert_array_equal(triangle_indices, np.where(replaced, np.arange(len(hits)), -1))
        return hits

    return run


UNIT = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


def random_corners(count, generator):
    return as_float32(generator.uniform(-1, 1, (count, 3, 3)))


def inner_points(corners, generator, margin=0.05):
    """Barycentric coordinates away from the edges, and the points there."""
    weights = generator.dirichlet([1, 1, 1], len(corners)) * (1 - 3 * margin) + margin
    return weights, np.einsum("ni,nij->nj", weights, corners)


@pytest.mark.parametrize("seed", range(2))
def test_hits_are_where_they_were_aimed(cross, seed):
    generator = np.random.default_rng([6, seed])
    corners = random_corners(20_000, generator)
    weights, points = inner_points(corners, generator)
    origins, directions = aim(generator.uniform(-3, 3, points.shape), points)

    # Where the triangle is not seen from the side, and is not a sliver.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slant = np.abs((normals * directions).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    seen = slant > 0.05
    assert seen.mean() > 0.7

    hits = cross(origins, directions, corners, prim_ids=np.arange(len(corners)))[seen]
    np.testing.assert_array_equal(hits["prim_id"], np.flatnonzero(seen))
    np.testing.assert_allclose(hits["t"], 1, rtol=0, atol=3e-5)
    np.testing.assert_allclose(hits["u"], weights[seen, 1], rtol=0, atol=1e-4)
    np.testing.assert_allclose(hits["v"], weights[seen, 2], rtol=0, atol=1e-4)


def test_both_sides_are_hit_alike(cross):
    front = cross([0.25, 0.5, 3], [0, 0, -1], UNIT)
    back = cross([0.25, 0.5, -3], [0, 0, 1], UNIT)
    assert front.tolist() == back.tolist() == [(3.0, 0.25, 0.5, 0)]


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_every_axis_and_order_of_corners(cross, axis, sign, order):
    # The weights are those of the first, second and third corner, in whatever order they come.
    corners = np.roll(UNIT, axis, axis=1)[list(order)]
    direction = np.roll([0.0, 0.0, sign], axis)
    point = np.array([0.625, 0.25, 0.125]) @ np.roll(UNIT, axis, axis=1)
    ((t, u, v, prim_id),) = cross(point - 2 * direction, direction, corners).tolist()
    weights = np.array([0.625, 0.25, 0.125])[list(order)]
    assert (t, u, v, prim_id) == (2, weights[1], weights[2], 0)


def test_beside_the_triangle_is_a_miss(cross):
    beside = np.array([[-0.01, 0.5, 1], [0.5, -0.01, 1], [0.51, 0.5, 1], [2, -1, 1], [-1, 2, 1], [-1, -1, 1]])
    assert cross(beside, [0, 0, -1], UNIT).tolist() == [MISS] * len(beside)


def test_a_ray_through_an_edge_is_taken_for_one_beside_it(cross):
    # It is moved towards zero by a little, and by much less in x and then in y.
    border = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [0.5, 0, 1], [0, 0.25, 1], [0.5, 0.5, 1], [0.25, 0.75, 1]])
    slanted = np.arange(len(border)) >= 5
    corner, middle, far = np.zeros(3), np.array([0.25, 0.25, 0]), np.array([8, 8, 0])
    for corners in (UNIT, UNIT[[1, 2, 0]], UNIT[[0, 2, 1]]):

        def is_hit(zero, corners=corners):
            return cross(border - zero, [0, 0, -1], corners - zero)["prim_id"] == 0

        # All of the border belongs to the triangle when zero is inside, and what faces away from it elsewhere.
        assert is_hit(corner).all()
        assert is_hit(middle).all()
        np.testing.assert_array_equal(is_hit(-far), slanted)
        np.testing.assert_array_equal(is_hit(far), [True, False, False, True, True, False, False])
        # The triangle on the other side of the slanted edge has what this one has not.
        np.testing.assert_array_equal(is_hit(far, [1, 1, 0] - corners), slanted)
        assert not is_hit(-far, [1, 1, 0] - corners)[slanted].any()


@pytest.mark.parametrize("seed", range(2))
def test_an_edge_or_a_corner_that_triangles_share_is_crossed_once(cross, seed):
    """Six triangles around a corner, in a plane or on a cone, and rays through the corner and through their edges."""
    generator = np.random.default_rng([14, seed])
    count = 20_000
    corner = generator.integers(-8, 9, (count, 1, 3))
    axis = generator.integers(0, 3, count)[:, None, None]
    ring = np.array([[2, 0], [1, 2], [-1, 2], [-2, 0], [-1, -2], [1, -2]]) * generator.integers(1, 4, (count, 1, 1))
    lift = generator.integers(-1, 2, (count, 1, 1)) * np.ones((1, 6, 1), int)
    around = np.take_along_axis(np.concatenate((ring, lift), axis=2), (np.arange(3) - axis - 1) % 3, axis=2)
    turned = np.where(generator.integers(0, 2, (count, 1, 1)) > 0, around, around[:, ::-1])
    towards = np.array([2.0**i for i in range(3)])[generator.integers(0, 3, count)]
    along = (axis[:, 0] == np.arange(3)) * towards[:, None] * generator.choice([-1, 1], (count, 1))
    # Half the rays meet the corner, the others the middle of an edge to it.
    target = np.where(generator.integers(0, 2, (count, 1)) > 0, corner[:, 0], corner[:, 0] + turned[:, 0] / 2)
    found = np.zeros(count, int)
    for i in range(6):
        fan = np.stack((corner[:, 0], corner[:, 0] + turned[:, i], corner[:, 0] + turned[:, (i + 1) % 6]), axis=1)
        found += cross(target - 4 * along, along, fan.astype(np.float64))["prim_id"] != NO_PRIM
    np.testing.assert_array_equal(found, 1)


def test_limits_are_inclusive(cross):
    three = np.float32(3)
    below, above = np.nextafter(three, np.float32(0)), np.nextafter(three, np.float32(9))
    t_min = [3, above, 0, 0, 3, -1, -np.inf, 4, np.inf]
    t_max = [np.inf, np.inf, 3, below, 3, -0.5, np.inf, 2, np.inf]
    hits = cross([[0.25, 0.25, 3]] * len(t_min), [0, 0, -1], UNIT, t_min=t_min, t_max=t_max)
    assert (hits["prim_id"] == 0).tolist() == [True, False, True, False, True, False, True, False, False]


def test_an_origin_on_the_surface_counts_at_0(cross):
    ((t, _, _, prim_id),) = cross([0.25, 0.25, 0], [1, 2, -3], UNIT).tolist()
    assert (t, prim_id) == (0, 0)


def test_what_lies_behind_counts_when_t_min_says_so(cross):
    ((t, _, _, prim_id),) = cross([0.25, 0.25, -2], [0, 0, -1], UNIT, t_min=-5).tolist()
    assert (t, prim_id) == (-2, 0)


def test_a_nearer_crossing_stays_and_a_farther_one_goes(cross):
    kept, replaced = (2.0, 0.5, 0.125, 7), (4.0, 0.5, 0.125, 7)
    assert cross([0.25, 0.25, 3], [0, 0, -1], UNIT, prim_ids=9, earlier=kept).tolist() == [kept]
    assert cross([0.25, 0.25, 3], [0, 0, -1], UNIT, prim_ids=9, earlier=replaced).tolist() == [(3.0, 0.25, 0.25, 9)]


def test_at_equal_distance_the_smaller_number_wins(cross):
    earlier = (3.0, 0.5, 0.125, 7)
    assert cross([0.25, 0.25, 3], [0, 0, -1], UNIT, prim_ids=9, earlier=earlier).tolist() == [earlier]
    assert cross([0.25, 0.25, 3], [0, 0, -1], UNIT, prim_ids=5, earlier=earlier)["prim_id"].tolist() == [5]


def test_three_equal_corners_are_never_hit(cross):
    generator = np.random.default_rng(7)
    corner = as_float32(generator.uniform(-1, 1, (20_000, 3)))
    origins, directions = aim(generator.uniform(-2, 2, corner.shape), corner)
    # Some start in the corner itself, some run along an axis.
    origins[:100] = corner[:100]
    directions[100:200, :2] = 0
    origins[100:200, :2] = corner[100:200, :2]
    hits = cross(origins, directions, np.repeat(corner[:, None], 3, axis=1))
    assert (hits["prim_id"] == NO_PRIM).all()


def test_a_line_on_the_grid_is_never_hit(cross):
    generator = np.random.default_rng(8)
    start = generator.integers(-8, 9, (5000, 3))
    step = generator.integers(-3, 4, (5000, 3))
    corners = np.stack((start, start + step, start + 3 * step), axis=1)
    directions = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0], [1, 1, 1], [-1, 1, 0]])[np.arange(5000) % 5]
    hits = cross(start + step - 4 * directions, directions, corners)
    assert (hits["prim_id"] == NO_PRIM).all()


def test_a_ray_in_the_plane_does_not_hit(cross):
    # On the grid, so that the plane is exact: from a point of the plane to another one, through the triangle or not.
    generator = np.random.default_rng(9)
    corners = generator.integers(-8, 9, (20_000, 3, 3)).astype(np.float64)
    along, over = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    steps = generator.integers(-3, 4, (2, 2, 20_000, 1))
    start, end = (corners[:, 0] + i * along + j * over for i, j in steps)
    # A shear by thirds would not be exact: the largest component is a power of two.
    size = np.abs(end - start).max(axis=1)
    exact = (size > 0) & (np.log2(np.maximum(size, 1)) % 1 == 0)
    assert exact.sum() > 500
    hits = cross(start[exact], (end - start)[exact], corners[exact])
    assert (hits["prim_id"] == NO_PRIM).all()


@pytest.mark.parametrize("exponent", [-30, -20, -1, 1, 27, 36])
def test_scale_changes_nothing(cross, exponent):
    generator = np.random.default_rng(10)
    corners = random_corners(5000, generator)
    _, points = inner_points(corners, generator, margin=-0.1)
    origins, directions = aim(generator.uniform(-3, 3, points.shape), points)
    scale = 2.0**exponent
    expected = cross(origins, directions, corners)
    assert 0.3 < (expected["prim_id"] == 0).mean() < 0.99
    # The scene is scaled with its rays, then without their directions.
    assert cross(origins * scale, directions * scale, corners * scale).tobytes() == expected.tobytes()
    hits = cross(origins * scale, directions, corners * scale)
    np.testing.assert_array_equal(hits["t"], expected["t"] * np.float32(scale))
    for field in ("u", "v", "prim_id"):
        np.testing.assert_array_equal(hits[field], expected[field])


@pytest.mark.parametrize("scale", [1e-6, 1e8])
def test_tiny_and_huge_triangles_are_hit(cross, scale):
    generator = np.random.default_rng(11)
    corners = as_float32(random_corners(5000, generator) * scale)
    _, points = inner_points(corners, generator, margin=0.2)
    origins, directions = aim(generator.uniform(-3, 3, points.shape) * scale, points)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = np.abs((normals * directions).sum(axis=1)) > 0.02 * scale**2 * np.linalg.norm(directions, axis=1)
    hits = cross(origins, directions, corners)[seen]
    assert len(hits) > 4000
    assert (hits["prim_id"] == 0).all()


@pytest.mark.parametrize("index", range(3))
@pytest.mark.parametrize("target", ["corner", "origin", "direction"])
def test_nan_hits_nothing(cross, target, index):
    origin, direction, corners = np.array([0.25, 0.25, 3.0]), np.array([0.0, 0.0, -1.0]), UNIT.copy()
    spoilt = {"corner": corners[index], "origin": origin, "direction": direction}[target]
    for axis in range(3):
        kept, spoilt[axis] = spoilt[axis], np.nan
        assert cross(origin, direction, corners)["prim_id"].tolist() == [NO_PRIM], "xyz"[axis]
        spoilt[axis] = kept
    assert cross(origin, direction, corners)["prim_id"].tolist() == [0]


@pytest.mark.parametrize("axis", range(3))
def test_an_origin_at_infinity_hits_nothing(cross, axis):
    origin = np.array([0.25, 0.25, 3.0])
    origin[axis] = np.inf
    assert cross(origin, [0, 0, -1], UNIT)["prim_id"].tolist() == [NO_PRIM]


def test_the_difference_of_products_has_the_right_sign(run_shell):
    generator = np.random.default_rng(12)
    factors = generator.uniform(-1, 1, (4000, 4)).astype(np.float32)
    # Products that agree in all but the last places, and products that are equal.
    factors[1000:, 3] = (factors[1000:, 0] * factors[1000:, 1]) / factors[1000:, 2]
    factors[3000:, 2:] = factors[3000:, 1::-1]
    (differences,) = run_shell("subtract_products", [factors], [np.float32])

    exact = [Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d) for a, b, c, d in factors.tolist()]
    zero = np.array([value == 0 for value in exact])
    assert zero[3000:].all()
    rounded = factors[:, 0] * factors[:, 1] - factors[:, 2] * factors[:, 3]
    assert np.mean((rounded == 0) & ~zero) > 0.05  # what a plain difference loses
    for value, wanted in zip(differences.tolist(), exact, strict=True):
        assert abs(Fraction(value) - wanted) <= Fraction(1.5) * Fraction(2) ** -23 * abs(wanted)

"""The triangle test: edges, limits, degenerate input, and rays that run in the triangle's plane."""

from fractions import Fraction

import numpy as np
import pytest

from clbvh.structs import NO_PRIM

from ..rays import aim, as_float32
from .programs import make_rays, make_triangles

pytestmark = pytest.mark.on_both

CROSS = """
    const ray_t unpacked = unpack_ray(ray);
    search_t search = make_search(1, 0);
    intersect_triangle(triangle, 0, &unpacked, &search, QUERY_CLOSEST);
    hit = as_hit(&search.nearest);
"""
UNIT = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


def cross_triangles(call, rays, triangles):
    """The hits of ray i with triangle i."""
    return call("triangles/single.cl", CROSS, "hit_t hit", ray=rays, triangle=triangles)


@pytest.fixture
def cross(call):
    """A function from rays and corners, pair by pair, to hits."""

    def run(origins, directions, corners, prim_ids=0, **limits):
        rays = make_rays(np.float32(origins), np.float32(directions), **limits)
        return cross_triangles(call, rays, make_triangles(np.broadcast_to(corners, (len(rays), 3, 3)), prim_ids))

    return run


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
    # An origin on the surface counts at 0, and what lies behind where t_min says so.
    assert cross([0.25, 0.25, 0], [1, 2, -3], UNIT)[["t", "prim_id"]].tolist() == [(0, 0)]
    assert cross([0.25, 0.25, -2], [0, 0, -1], UNIT, t_min=-5)[["t", "prim_id"]].tolist() == [(-2, 0)]


def test_triangles_without_an_area_and_rays_in_their_plane_do_not_hit(cross):
    generator = np.random.default_rng(7)
    # Three equal corners; some rays start in the corner itself, some run along an axis.
    corner = as_float32(generator.uniform(-1, 1, (20_000, 3)))
    origins, directions = aim(generator.uniform(-2, 2, corner.shape), corner)
    origins[:100] = corner[:100]
    directions[100:200, :2], origins[100:200, :2] = 0, corner[100:200, :2]
    assert (cross(origins, directions, np.repeat(corner[:, None], 3, axis=1))["prim_id"] == NO_PRIM).all()
    # Lines on the grid.
    start, step = generator.integers(-8, 9, (5000, 3)), generator.integers(-3, 4, (5000, 3))
    directions = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0], [1, 1, 1], [-1, 1, 0]])[np.arange(5000) % 5]
    hits = cross(start + step - 4 * directions, directions, np.stack((start, start + step, start + 3 * step), axis=1))
    assert (hits["prim_id"] == NO_PRIM).all()
    # On the grid, so that the plane is exact: from a point of the plane to another one, through the triangle or not.
    corners = generator.integers(-8, 9, (20_000, 3, 3)).astype(np.float64)
    along, over = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    start, end = (corners[:, 0] + i * along + j * over for i, j in generator.integers(-3, 4, (2, 2, 20_000, 1)))
    # A shear by thirds would not be exact: the largest component is a power of two.
    size = np.abs(end - start).max(axis=1)
    exact = (size > 0) & (np.log2(np.maximum(size, 1)) % 1 == 0)
    assert exact.sum() > 500
    assert (cross(start[exact], (end - start)[exact], corners[exact])["prim_id"] == NO_PRIM).all()


def test_nan_and_an_origin_at_infinity_hit_nothing(cross):
    spoilt = [(part, axis, np.nan) for part in range(5) for axis in range(3)] + [(0, axis, np.inf) for axis in range(3)]
    for part, axis, value in spoilt:
        values = np.array([[0.25, 0.25, 3], [0, 0, -1], *UNIT])
        assert cross(values[0], values[1], values[2:])["prim_id"].tolist() == [0]
        values[part, axis] = value
        assert cross(values[0], values[1], values[2:])["prim_id"].tolist() == [NO_PRIM], (part, axis, value)


def test_the_difference_of_products_has_the_right_sign(call):
    factors = np.random.default_rng(12).uniform(-1, 1, (4000, 4)).astype(np.float32)
    # Products that agree in all but the last places, and products that are equal.
    factors[1000:, 3] = (factors[1000:, 0] * factors[1000:, 1]) / factors[1000:, 2]
    factors[3000:, 2:] = factors[3000:, 1::-1]
    body = "difference = difference_of_products(f.x, f.y, f.z, f.w);"
    differences = call("triangles/triangle.cl", body, "float difference", f=factors)
    exact = [Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d) for a, b, c, d in factors.tolist()]
    assert exact[3000:] == [0] * 1000
    rounded = factors[:, 0] * factors[:, 1] - factors[:, 2] * factors[:, 3]
    assert np.mean((rounded == 0) & (np.array(exact) != 0)) > 0.05  # what a plain difference loses
    for value, wanted in zip(differences.tolist(), exact, strict=True):
        assert abs(Fraction(value) - wanted) <= Fraction(1.5) * Fraction(2) ** -23 * abs(wanted)

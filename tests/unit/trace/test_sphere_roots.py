"""Crossings of spheres, against decimal arithmetic of 60 digits."""

from __future__ import annotations

import decimal
import math
from decimal import Decimal

import numpy as np
import pytest

from clbvh.trace.hits.spheres import sphere_crossing

ROUNDING = 2.0**-53


@pytest.fixture(autouse=True)
def _many_digits():
    with decimal.localcontext() as context:
        context.prec = 60
        context.Emax, context.Emin = 10_000, -10_000
        yield


def exactly(values):
    return [Decimal(float(value)) for value in values]


def crossing_t(*arguments):
    return sphere_crossing(*arguments)[0]


def dot(one, other):
    return sum(a * b for a, b in zip(one, other, strict=True))


def find_roots(origin, direction, centre, radius):
    """Both t, or none, by the formula."""
    o, d, c, r = exactly(origin), exactly(direction), exactly(centre), Decimal(float(radius))
    f = [a - b for a, b in zip(o, c, strict=True)]
    square, towards = dot(d, d), -dot(f, d)
    discriminant = towards * towards - square * (dot(f, f) - r * r)
    if discriminant < 0:
        return None
    root = discriminant.sqrt()
    return (towards - root) / square, (towards + root) / square


def aim_at_spheres(seed, size, distance, count=150):
    """Rays to points inside spheres of a size, from a distance in radii; directions of any length."""
    rng = np.random.default_rng([seed, 5])
    centres = rng.normal(size=(count, 3)) * size
    radii = size * rng.uniform(0.5, 2, count)
    origins = centres + radii[:, None] * distance * rng.normal(size=(count, 3))
    inner = rng.normal(size=(count, 3))
    inner *= 0.9 * rng.random((count, 1)) / np.linalg.norm(inner, axis=1)[:, None]
    directions = (centres + radii[:, None] * inner - origins) * 10.0 ** rng.uniform(-5, 5, (count, 1))
    return origins, directions, centres, radii


@pytest.mark.parametrize("size", [1e-140, 1e-30, 1.0, 1e30, 1e140])
@pytest.mark.parametrize("distance", [0.1, 1.0, 10.0, 1e6, 1e12])
@pytest.mark.parametrize("seed", [0])
def test_both_crossings_are_those_of_the_formula(seed, size, distance):
    worst = 0.0
    for origin, direction, centre, radius in zip(*aim_at_spheres(seed, size, distance), strict=True):
        roots = find_roots(origin, direction, centre, radius)
        if roots is None:  # the rounded ray of a long way passes by
            assert distance > 1e10
            continue
        found = [
            sphere_crossing(tuple(origin), tuple(direction), tuple(centre), radius, leaving)
            for leaving in (False, True)
        ]
        assert found[0][0] <= found[1][0]
        # The slope of the surface where the ray meets it: beside it, a root moves more than the surface does.
        speed = float(dot(exactly(direction), exactly(direction)).sqrt())
        half_chord = float(roots[1] - roots[0]) / 2 * speed
        reach = max(radius, float(np.abs(origin - centre).max()))
        for (t, x, y, z), expected in zip(found, roots, strict=True):
            error = abs(float(Decimal(t) - expected)) * speed
            worst = max(worst, error / (reach * max(1.0, radius / half_chord)))
            assert math.hypot(x, y, z) == pytest.approx(1, abs=1e-15)
            point = [
                (Decimal(float(o)) + expected * Decimal(float(d)) - Decimal(float(c))) / Decimal(float(radius))
                for o, d, c in zip(origin, direction, centre, strict=True)
            ]
            assert [x, y, z] == pytest.approx([float(p) for p in point], abs=1e-13 + 1e-14 * distance)
    assert worst < 12 * ROUNDING


def test_a_start_on_the_surface_has_a_t_of_exactly_zero():
    assert crossing_t((1.0, 0.0, 0.0), (-1.0, 0.5, 0.0), (0.0, 0.0, 0.0), 1.0, False) == 0
    assert crossing_t((1.0, 0.0, 0.0), (1.0, 0.5, 0.0), (0.0, 0.0, 0.0), 1.0, True) == 0
    # Beside the surface nothing cancels.
    height = 2.0**-40
    assert crossing_t((1.0 + height, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, False) == pytest.approx(
        height, rel=1e-4
    )


def test_the_crossings_of_a_start_inside_lie_on_both_sides():
    enter, leave = (crossing_t((0.5, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, end) for end in (0, 1))
    assert (enter, leave) == (-0.75, 0.25)


def test_a_small_sphere_far_away_is_entered_before_it_is_left():
    for exponent in range(-60, 0, 3):
        radius = 2.0**exponent
        enter, leave = (crossing_t((-1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), radius, end) for end in (0, 1))
        assert enter <= leave
        assert [enter, leave] == pytest.approx([(1 - radius) / 3, (1 + radius) / 3], rel=1e-15)


def test_a_line_beside_the_sphere_has_its_closest_point():
    t, *normal = sphere_crossing((-4.0, 1.0 + 1e-9, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, False)
    assert (t, normal) == (2.0, [0, 1, 0])
    # Tangent: both crossings are one.
    for leaving in (False, True):
        t, *normal = sphere_crossing((-4.0, 1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, leaving)
        assert (t, normal) == (2.0, [0, 1, 0])

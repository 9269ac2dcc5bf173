"""Points of spheres in doubles: crossings, coordinates, and the sines and angles that they are made of."""

import decimal
from decimal import Decimal

import numpy as np
import pytest

pytestmark = pytest.mark.on_both


def assert_close(found, exact):
    """Within 0.51 units in the last place, with the error of long doubles."""
    units = np.abs(found - exact) / np.spacing(np.abs(found)).astype(np.longdouble)
    assert np.nanmax(np.where(found == exact, 0, units)) <= 0.51


def test_sines_and_cosines_are_nearly_those_that_are_rounded_once(call):
    angles = np.random.default_rng(3).uniform(-np.pi / 4, np.pi / 4, 100_000)
    angles[:1000] *= np.geomspace(1e-300, 1, 1000)
    angles[-40:] = [np.pi / 4, 0, *np.arange(-19, 19) / 32 / 1.5]
    body = "found = sine_and_cosine(angle);"
    sines, cosines = call("math/angles.cl", body, "double2 found", angle=angles, has_doubles=True).T
    assert_close(sines, np.sin(angles.astype(np.longdouble)))
    assert_close(cosines, np.cos(angles.astype(np.longdouble)))


def test_angles_are_nearly_those_that_are_rounded_once(call):
    vectors = np.random.default_rng(4).normal(size=(100_000, 2))
    vectors[:20_000, 0] *= np.geomspace(1e-200, 1, 20_000)
    vectors[20_000:40_000, 1] *= np.geomspace(1e-200, 1, 20_000)
    vectors[40_000:60_000, 0] = vectors[40_000:60_000, 1] * np.linspace(-2.5, 2.5, 20_000)
    vectors[-9:] = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [32, 1]]
    body = "angle = angle_of(vector.y, vector.x);"
    angles = call("math/angles.cl", body, "double angle", vector=vectors, has_doubles=True)
    x, y = vectors.T.astype(np.longdouble)
    assert_close(angles, np.arctan2(y, x))


def exactly(values):
    return np.array([Decimal(float(value)) for value in values])


@pytest.mark.parametrize("size", [1e-140, 1.0, 1e140])
@pytest.mark.parametrize("distance", [0.1, 1.0, 10.0, 1e6, 1e12])
def test_crossings_of_spheres_are_those_of_60_digits(call, size, distance):
    """For rays to points inside, from a distance in radii; directions of any length."""
    rng, cases = np.random.default_rng(5), []
    for _ in range(100):
        centre, radius = rng.normal(size=3) * size, size * rng.uniform(0.5, 2)
        origin, inner = centre + radius * distance * rng.normal(size=3), rng.normal(size=3)
        inner *= 0.9 * rng.random() / np.linalg.norm(inner)
        direction = (centre + radius * inner - origin) * 10.0 ** rng.uniform(-5, 5)
        cases += [(origin, direction, centre, radius, is_leaving) for is_leaving in (0, 1)]
    names = ("origin", "direction", "centre", "radius", "is_leaving")
    ts, normals = call(
        "spheres/crossing.cl", "t = sphere_crossing(origin, direction, centre, radius, is_leaving, &normal);",
        "double t, double3 normal", has_doubles=True,
        **{name: np.array(values) for name, values in zip(names, zip(*cases, strict=True), strict=True)},
    )  # fmt: skip
    for (origin, direction, centre, radius, is_leaving), t, normal in zip(cases, ts, normals, strict=True):
        with decimal.localcontext() as context:
            context.prec, context.Emax, context.Emin = 60, 10_000, -10_000
            d, from_centre = exactly(direction), exactly(origin) - exactly(centre)
            square, towards, r = d @ d, -(from_centre @ d), Decimal(float(radius))
            discriminant = towards * towards - square * (from_centre @ from_centre - r * r)
            if discriminant < 0:  # the rounded ray of a long way passes by
                assert distance > 1e10
                continue
            speed, half = square.sqrt(), discriminant.sqrt() / square
            # Beside the rim, a root moves more than the surface does.
            reach = Decimal(max(radius, np.abs(origin - centre).max())) * max(1, r / (half * speed))
            expected = towards / square + (half if is_leaving else -half)
            assert abs(Decimal(float(t)) - expected) * speed < 12 * Decimal(2.0**-53) * reach
            at = ((from_centre + expected * d) / r).astype(float)
            np.testing.assert_allclose(normal, at, rtol=0, atol=1e-13 + 1e-14 * distance)
            assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-15)


def test_points_of_spheres_come_back_from_their_angles(call):
    """Everywhere, and next to poles and the seam."""
    generator, axes = np.random.default_rng(0), np.concatenate((np.eye(3), -np.eye(3)))
    parts = [axes]
    for width in (1.0, 1e-8, 1e-200):
        parts.append(generator.normal(size=(20_000, 3)) * [width, width, 1])
        parts.append(np.abs(generator.normal(size=(20_000, 3))) * [1, -width, 1])
    points = np.concatenate(parts)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    body = "uv = sphere_uv(point); back = sphere_point(uv.x, uv.y);"
    coordinates, back = call("spheres/crossing.cl", body, "double2 uv, double3 back", point=points, has_doubles=True)
    assert np.linalg.norm(points - back, axis=1).max() < 1.2e-15
    assert (coordinates >= 0).all()
    assert (coordinates < [1, np.nextafter(1, 2)]).all()
    np.testing.assert_array_equal(back[:6], axes)
    expected = [[0, 0.5], [0.25, 0.5], [0, 0], [0.5, 0.5], [0.75, 0.5], [0, 1]]
    np.testing.assert_array_equal(coordinates[:6], expected)

"""Answers known by theorem or formula: closed meshes let no ray out; crossings and closest points of round shapes."""

import decimal
from decimal import Decimal

import numpy as np
import pytest

from clbvh.support.compiled import compiled
from clbvh.trace.hits.spheres import sphere_crossing, sphere_point, sphere_uv

from ...closed_meshes import BUNNY, MAKERS, NAMES, open_closed_mesh, scan_path
from ...profiles import seeds


@pytest.fixture(scope="module", params=NAMES)
def closed(request, open_tracer):
    """A closed mesh, a tracer of it, and a function that makes points inside."""
    if request.param == "bunny" and not scan_path(BUNNY).is_file():
        pytest.skip(f"CLBVH_MESHES names no folder with {BUNNY}")
    mesh, inside = open_closed_mesh(request.param)
    return mesh, open_tracer(mesh), inside


@pytest.mark.parametrize("seed", seeds(2))
@pytest.mark.parametrize("make_rays", MAKERS, ids=lambda f: f.__name__)
def test_no_ray_escapes_from_a_closed_mesh(closed, make_rays, seed):
    mesh, tracer, inside = closed
    origins, directions = make_rays(mesh, inside, 1 << 16, np.random.default_rng([50, seed]))
    hits = tracer.closest_hit(origins, directions)
    assert np.flatnonzero(~hits.is_hit).tolist() == []
    assert tracer.any_hit(origins, directions).all()
    # From inside, a ray goes out once more than it goes in.
    assert np.flatnonzero(tracer.count_hits(origins, directions) % 2 == 0).tolist() == []
    assert len(np.unique(hits.prim_id)) > 0.5 * min(mesh.face_count, 4000)


def exactly(values):
    return np.array([Decimal(float(value)) for value in values])


@pytest.mark.parametrize("size", [1e-140, 1.0, 1e140])
@pytest.mark.parametrize("distance", [0.1, 1.0, 10.0, 1e6, 1e12])
def test_crossings_of_spheres_are_those_of_60_digits(size, distance):
    """For rays to points inside, from a distance in radii; directions of any length."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        centre, radius = rng.normal(size=3) * size, size * rng.uniform(0.5, 2)
        origin, inner = centre + radius * distance * rng.normal(size=3), rng.normal(size=3)
        inner *= 0.9 * rng.random() / np.linalg.norm(inner)
        direction = (centre + radius * inner - origin) * 10.0 ** rng.uniform(-5, 5)
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
            for leaving in (False, True):
                t, *normal = sphere_crossing(tuple(origin), tuple(direction), tuple(centre), radius, leaving)
                expected = towards / square + (half if leaving else -half)
                assert abs(Decimal(t) - expected) * speed < 12 * Decimal(2.0**-53) * reach
                at = ((from_centre + expected * d) / r).astype(float)
                np.testing.assert_allclose(normal, at, rtol=0, atol=1e-13 + 1e-14 * distance)
                assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-15)


@compiled
def _round_trip(points, coordinates, back):
    for point in range(len(points)):
        u, v = sphere_uv(points[point, 0], points[point, 1], points[point, 2])
        coordinates[point, 0], coordinates[point, 1] = u, v
        back[point, 0], back[point, 1], back[point, 2] = sphere_point(u, v)


def test_points_of_spheres_come_back_from_their_angles():
    """Everywhere, and next to poles and the seam."""
    generator, axes = np.random.default_rng(0), np.concatenate((np.eye(3), -np.eye(3)))
    parts = [axes]
    for width in (1.0, 1e-8, 1e-200):
        parts.append(generator.normal(size=(20_000, 3)) * [width, width, 1])
        parts.append(np.abs(generator.normal(size=(20_000, 3))) * [1, -width, 1])
    points = np.concatenate(parts)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    coordinates, back = np.empty((len(points), 2)), np.empty((len(points), 3))
    _round_trip(points, coordinates, back)
    assert np.linalg.norm(points - back, axis=1).max() < 1.2e-15
    assert (coordinates >= 0).all()
    assert (coordinates < [1, np.nextafter(1, 2)]).all()
    np.testing.assert_array_equal(back[:6], axes)
    expected = [[0, 0.5], [0.25, 0.5], [0, 0], [0.5, 0.5], [0.75, 0.5], [0, 1]]
    np.testing.assert_array_equal(coordinates[:6], expected)

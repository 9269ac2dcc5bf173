"""Answers that are known by formula: closed meshes let no ray out; boxes, spheres, ellipsoids, mirrored instances."""

import decimal
from decimal import Decimal

import numpy as np
import pytest

from clbvh import Mesh, Scene, Spheres, Tracer
from clbvh.support.compiled import compiled
from clbvh.trace.hits.spheres import sphere_crossing, sphere_point, sphere_uv
from clbvh.trace.points.ellipsoid import find_shares

from ...closed_meshes import BUNNY, MAKERS, NAMES, open_closed_mesh, scan_path
from ...profiles import seeds
from ...rays import AXES, centred
from .scene_distances import distance_to_ellipsoid
from .scene_states import affine

SQUARE = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
# Two triangles for each side: -x, +x, -y, +y, -z, +z.
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = [triangle for a, b, c, d in QUADS for triangle in ((a, b, c), (a, c, d))]


def scene_of(shape, *transforms, masks=None):
    scene = Scene()
    geometry = scene.add(shape)
    for index, transform in enumerate(transforms):
        scene.place(geometry, transform, mask=masks[index] if masks else 2**32 - 1)
    return scene


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


def test_a_cube_is_closed_along_its_faces_and_edges(session):
    """Every leaf's box is flat or shares its faces with that of the mesh."""
    steps = np.linspace(-0.5, 0.5, 17)
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    inner = grid[(np.abs(grid) < 0.5).all(axis=1)]
    with Tracer(centred(Mesh.from_arrays(CORNERS, FACES)), device=session.info) as tracer:
        for direction in AXES.astype(np.float64):
            # From outside, one size away; the rays on the border run in the sides of the cube.
            origins = np.where(direction == 0, grid, -1.5 * direction)
            assert (tracer.closest_hit(origins, direction).t == 1).all()
            np.testing.assert_array_equal(tracer.closest_hit(inner, direction).t, 0.5 - inner @ direction)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_an_ellipsoid_is_crossed_where_the_formula_says(session, scale):
    """Half axes 3, 1, 2: a ray along x at (y, z) is inside for 3 sqrt(1 - y^2 - z^2 / 4) to each side."""
    y, z = np.random.default_rng(5).uniform(-0.6, 0.6, (2, 50))
    half = 3 * np.sqrt(1 - y**2 - z**2 / 4)
    for distance in (7.0, 1e7):
        transform = affine(np.diag([3, 1, 2]) * scale, np.array([distance, 0, 0]) * scale)
        with Tracer(scene_of(Spheres([[0, 0, 0]], 1.0), transform), device=session.info) as tracer:
            hits = tracer.all_hits(np.column_stack((np.zeros(50), y, z)) * scale, np.array([1, 0, 0]) * scale)
        expected = np.column_stack((distance - half, distance + half)).reshape(-1)
        np.testing.assert_allclose(hits.t, expected, rtol=2.0**-50, atol=1e-11)
        assert hits.is_front.tolist() == [True, False] * 50
        # The normal of an ellipsoid is along x / 9, y, z / 4.
        normals = (hits.locations / scale - [distance, 0, 0]) / [9, 1, 4]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        np.testing.assert_allclose(hits.normals, normals, atol=1e-15 * distance + 1e-11)


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


def test_special_crossings_of_spheres():
    centre = (0.0, 0.0, 0.0)
    for origin, direction, leaving, expected in (
        ((1.0, 0.0, 0.0), (-1.0, 0.5, 0.0), False, [0]),  # on the surface
        ((1.0, 0.0, 0.0), (1.0, 0.5, 0.0), True, [0]),
        ((0.5, 0.0, 0.0), (2.0, 0.0, 0.0), False, [-0.75]),  # inside
        ((0.5, 0.0, 0.0), (2.0, 0.0, 0.0), True, [0.25]),
        ((-4.0, 1.0, 0.0), (2.0, 0.0, 0.0), False, [2, 0, 1, 0]),  # touching, and beside
        ((-4.0, 1.0, 0.0), (2.0, 0.0, 0.0), True, [2, 0, 1, 0]),
        ((-4.0, 1.0 + 1e-9, 0.0), (2.0, 0.0, 0.0), False, [2, 0, 1, 0]),
    ):
        found = sphere_crossing(origin, direction, centre, 1.0, leaving)
        assert list(found[: len(expected)]) == expected, (origin, direction)
    for radius in 2.0 ** np.arange(-60, 0, 3):
        enter, leave = (sphere_crossing((-1.0, 0.0, 0.0), (3.0, 0.0, 0.0), centre, radius, end)[0] for end in (0, 1))
        assert enter <= leave
        assert [enter, leave] == pytest.approx([(1 - radius) / 3, (1 + radius) / 3], rel=1e-15)


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
    for width in (1.0, 1e-3, 1e-8, 1e-15, 1e-30, 1e-200):
        parts.append(generator.normal(size=(20_000, 3)) * [width, width, 1])
        parts.append(np.abs(generator.normal(size=(20_000, 3))) * [1, -width, 1])
    points = np.concatenate(parts)
    points /= np.sqrt((points**2).sum(axis=1, keepdims=True))
    coordinates, back = np.empty((len(points), 2)), np.empty((len(points), 3))
    _round_trip(points, coordinates, back)
    exact = points.astype(np.longdouble)
    exact /= np.sqrt((exact**2).sum(axis=1, keepdims=True))
    assert np.sqrt(((exact - back) ** 2).sum(axis=1)).max() < 1e-15
    assert (coordinates >= 0).all()
    assert (coordinates < [1, np.nextafter(1, 2)]).all()
    np.testing.assert_array_equal(back[:6], axes)
    expected = [[0, 0.5], [0.25, 0.5], [0, 0], [0.5, 0.5], [0.75, 0.5], [0, 1]]
    np.testing.assert_array_equal(coordinates[:6], expected)


@pytest.mark.parametrize("lengths", [(1, 0.3, 4), (2, 2, 2), (2, 2, 1), (3, 3e-5, 3e-5), (0.4, 0.4, 4e-8)], ids=str)
def test_the_closest_points_of_an_ellipsoid(lengths):
    """To points around, close to the surface, within, and on planes and axes of symmetry."""
    generator = np.random.default_rng(1300)
    lengths = generator.permutation(np.array(lengths, np.float64))
    anywhere = generator.normal(size=(600, 3)) * lengths.max() * 10.0 ** generator.uniform(-6, 2, (600, 1))
    surface = generator.normal(size=(600, 3))
    surface *= lengths / np.linalg.norm(surface, axis=1, keepdims=True)
    beside = surface * (1 + 1e-6 * generator.normal(size=(600, 1)))
    positions = np.abs(np.concatenate((anywhere, surface, beside)))
    for axis in range(3):
        positions[:: 4 + axis, axis] = 0
    shares = np.empty_like(positions)
    for position, share in zip(positions, shares, strict=True):
        find_shares(position, lengths, share)
    np.testing.assert_allclose(np.linalg.norm(shares, axis=1), 1, rtol=0, atol=1e-15)
    assert (shares >= 0).all()
    distance = np.linalg.norm(positions - shares * lengths, axis=1)
    expected = distance_to_ellipsoid(positions, np.zeros(3), np.diag(lengths))
    reach = np.maximum(np.linalg.norm(positions, axis=1), lengths.max())
    assert (np.abs(distance - expected) <= 4e-15 * reach).all()

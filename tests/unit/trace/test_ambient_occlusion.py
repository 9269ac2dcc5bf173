"""Ambient occlusion against form factors, and points on surfaces that must not see what they lie on."""

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import ConfigError, Mesh, QueryError, Spheres, Tracer, Transform, make_shape
from clbvh.geometry import as_mesh
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.points import ambient_occlusion as query

from .scene_states import affine, random_linear, turn

LAYOUTS = list(LAYOUT_WIDTHS)
UP = [0.0, 0.0, 1.0]
BOX = as_mesh(trimesh.creation.box(extents=(1.0, 0.8, 0.6)))
TURN = turn(0, 0.7) @ turn(1, 2.1) @ turn(2, 4.0)
CONVEX = {
    "box": BOX,
    "slab": Mesh.from_arrays(BOX.vertices * [1, 1, 1e-3], BOX.faces),
    "sphere": make_shape("icosphere", triangles=1280),
}

# Scrambled points in 1,024 cells: the error of a share is that of the cells on an edge, some tens of them.
RAYS = 1024
ERROR = 8e-3


def square_of(size):
    """A square in the plane z = 0."""
    return Mesh.from_arrays(
        [[-size, -size, 0], [size, -size, 0], [size, size, 0], [-size, size, 0]], [[0, 1, 2], [0, 2, 3]]
    )


def disk_at(height, radius, corners=720):
    """A disk around the z axis."""
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.column_stack((radius * np.cos(angles), radius * np.sin(angles), np.full(corners, height)))
    faces = [[corners, i, (i + 1) % corners] for i in range(corners)]
    return Mesh.from_arrays(np.vstack((rim, [[0, 0, height]])), faces)


def scene_of(*shapes):
    scene = clbvh.Scene()
    for shape in shapes:
        shape, transform = shape if isinstance(shape, tuple) else (shape, np.eye(4))
        scene.place(scene.add(shape), transform)
    return scene


def points_on(mesh, count, seed, spread=0.3):
    """Random points on a mesh with the normals of their faces, outwards for convex meshes around their middle."""
    generator = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces]
    picked = corners[generator.integers(0, len(corners), count)]
    shares = generator.dirichlet([spread] * 3, count)  # below 1: often close to edges and corners
    normals = np.cross(picked[:, 1] - picked[:, 0], picked[:, 2] - picked[:, 0])
    outwards = np.einsum("ij,ij->i", normals, picked[:, 0] - mesh.vertices.mean(axis=0)) >= 0
    return np.einsum("ij,ijk->ik", shares, picked), np.where(outwards[:, None], normals, -normals)


@pytest.fixture(params=LAYOUTS)
def trace(request, session):
    """A function that opens a tracer in one of the layouts."""
    return lambda source: Tracer(source, device=session.info, layout=request.param)


class TestFormulas:
    def test_a_plane_leaves_its_own_side_open(self, trace):
        points = np.random.default_rng(1).uniform(-1, 1, (500, 3)) * [1, 1, 0]
        with trace(square_of(1)) as tracer:
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, UP), 1)
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, [0, 0, -1e-30]), 1)

    def test_nothing_is_open_inside_of_a_closed_box(self, trace):
        points, normals = points_on(BOX, 500, seed=2, spread=3.0)
        with trace(BOX) as tracer:
            middle = BOX.vertices.mean(axis=0)
            assert tracer.ambient_occlusion(middle, UP) == 0
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, -normals), 0)

    @pytest.mark.parametrize("height", [0.2, 1.0, 3.0])
    def test_under_a_disk(self, trace, height):
        with trace(disk_at(height, 1.0)) as tracer:
            share = tracer.ambient_occlusion([0, 0, 0], UP, rays=RAYS)
        assert share == pytest.approx(1 - 1 / (1 + height**2), abs=ERROR)

    def test_a_wide_ceiling_hides_the_sky(self, trace):
        with trace(square_of(1e5)) as tracer:
            np.testing.assert_allclose(tracer.ambient_occlusion([[0, 0, -1]], UP, rays=RAYS), 0, atol=2e-3)

    @pytest.mark.parametrize("angle", [0, 30, 60])
    def test_a_sphere_over_a_plane(self, trace, angle):
        """The form factor of a sphere above the horizon is (radius / distance)^2 cos(angle)."""
        angle = np.radians(angle)
        centre = 2.5 * np.array([np.sin(angle), 0, np.cos(angle)])
        with trace(scene_of(square_of(50), Spheres([centre], 1.0))) as tracer:
            share = tracer.ambient_occlusion([0, 0, 0], UP, rays=RAYS)
        assert share == pytest.approx(1 - np.cos(angle) / 2.5**2, abs=ERROR)

    def test_a_corner_of_two_planes_hides_half(self, trace):
        size = 1e4
        corner = Mesh.from_arrays(
            [[0, -size, 0], [size, -size, 0], [size, size, 0], [0, size, 0], [0, -size, size], [0, size, size]],
            [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]],
        )
        with trace(corner) as tracer:
            shares = tracer.ambient_occlusion([[1, 0, 0], [0, 0, 1]], [[0, 0, 1], [1, 0, 0]], rays=RAYS)
        np.testing.assert_allclose(shares, 0.5, atol=ERROR)

    def test_what_is_too_far_away_blocks_nothing(self, trace):
        with trace(disk_at(1.0, 1.0)) as tracer:
            assert tracer.ambient_occlusion([0, 0, 0], UP, rays=RAYS, max_distance=0.99) == 1
            shares = tracer.ambient_occlusion([[0, 0, 0]] * 3, UP, rays=RAYS, max_distance=[0.5, 1.2, np.inf])
        # Within 1.2, the disk hides the cone to the ring at that distance, of which the cosine is 1 / 1.2.
        np.testing.assert_allclose(shares, [1, 1 / 1.2**2, 0.5], atol=ERROR)

    def test_the_error_falls_faster_than_that_of_random_rays(self, session):
        points = np.zeros((400, 3))
        with Tracer(disk_at(1.0, 1.0), device=session.info) as tracer:
            few, many = (np.std(tracer.ambient_occlusion(points, UP, rays=rays)) for rays in (16, 256))
        assert few < 0.5 / np.sqrt(16)
        assert many < few / 16**0.6


class TestSurfaces:
    """Points on convex bodies see all of the sky, whatever rounds their coordinates."""

    @pytest.mark.parametrize("name", CONVEX)
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize(("unit", "away"), [(1, 0), (1e-30, 0), (1e30, 0), (1, 1e3), (1, 1e9)])
    def test_of_a_mesh(self, trace, name, dtype, unit, away):
        mesh = CONVEX[name]
        turned = mesh.vertices @ TURN.T
        mesh = Mesh.from_arrays(unit * (turned + away * np.array([1, -2, 0.5])), mesh.faces)
        points, normals = points_on(mesh, 300, seed=4)
        with trace(mesh) as tracer:
            shares = tracer.ambient_occlusion(points.astype(dtype), normals / unit**2, rays=32)
        np.testing.assert_array_equal(shares, 1)

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("away", [0.0, 1e4])
    def test_of_instances(self, trace, seed, away):
        generator = np.random.default_rng(seed)
        linear = random_linear(generator, stretch=10.0)
        transform = affine(linear=linear, offset=away * generator.normal(size=3))
        mesh = CONVEX["sphere"]
        world = Mesh.from_arrays(mesh.vertices @ linear.T + transform[:3, 3], mesh.faces)
        points, normals = points_on(world, 300, seed)
        with trace(scene_of((mesh, transform))) as tracer:
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, normals, rays=32), 1)

    def test_of_spheres(self, trace):
        generator = np.random.default_rng(5)
        normals = generator.normal(size=(300, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        transform = affine(linear=3.0 * TURN, offset=(100, 200, -50))
        with trace(scene_of((Spheres([[0, 0, 0], [1e3, 0, 0]], 1.0), transform))) as tracer:
            points = 3.0 * normals + transform[:3, 3]
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, normals, rays=32), 1)
            np.testing.assert_array_equal(tracer.ambient_occlusion(points, -normals, rays=32), 0)

    def test_a_small_body_on_large_ground_is_not_lifted_off_it(self, trace):
        """The lift is that of the largest instance around the point, 10^-5 of its size."""
        body = Transform(scale=0.01)
        with trace(scene_of(square_of(1.0), (BOX, body))) as tracer:
            beside = 0.01 * np.abs(BOX.vertices).max() * 1.01
            share = tracer.ambient_occlusion([beside, 0, 0], UP, rays=RAYS)
        assert share < 0.6

    @pytest.mark.parametrize("size", [1e-5, 1e-3])
    def test_points_are_lifted_by_the_size_of_their_own_instance(self, trace, size):
        # Not at the edges: there, rounding may lead out through the neighbour.
        points, normals = points_on(BOX, 300, seed=8, spread=3.0)
        with trace(scene_of((square_of(1.0), affine(offset=(0, 0, -1))), (BOX, affine(linear=[size] * 3)))) as tracer:
            np.testing.assert_array_equal(tracer.ambient_occlusion(size * points, -normals, rays=32), 0)

    def test_an_offset_leads_out_of_the_surface(self, trace):
        with trace(square_of(1)) as tracer:
            below = [0.1, 0.2, -1e-3]
            assert tracer.ambient_occlusion(below, UP, rays=RAYS) < 0.01
            assert tracer.ambient_occlusion(below, UP, rays=RAYS, offset=1.1e-3) == 1


@pytest.fixture(scope="module")
def grooved():
    """A surface with many different shares, points on it and their normals."""
    mesh = make_shape("terrain", triangles=5000, seed=1)
    points, normals = points_on(mesh, 700, seed=7)
    return mesh, points, normals


class TestSamples:
    def test_layouts_and_cuts_agree(self, session, grooved, monkeypatch):
        mesh, points, normals = grooved
        arguments = {"rays": 100, "seed": 3}
        shares = []
        for layout in LAYOUTS:
            with Tracer(mesh, device=session.info, layout=layout) as tracer:
                shares.append(tracer.ambient_occlusion(points, normals, **arguments))
        assert len(np.unique(shares[0])) > 10
        with Tracer(mesh, device=session.info) as tracer:
            monkeypatch.setattr(query, "_LAUNCH_RAYS", 1000)
            shares.append(tracer.ambient_occlusion(points, normals, **arguments))
            monkeypatch.setattr(query, "_LEAST_POINTS", 100)
            shares.append(tracer.ambient_occlusion(points, normals, **arguments))
        for other in shares[1:]:
            np.testing.assert_array_equal(other, shares[0])

    def test_layouts_of_a_scene_agree(self, session, grooved):
        mesh, points, normals = grooved
        shares = []
        for layout in LAYOUTS:
            # A scene of one mesh alone would be that mesh.
            with Tracer(scene_of(mesh, mesh), device=session.info, layout=layout) as tracer:
                shares.append(tracer.ambient_occlusion(points, normals, rays=100, seed=3))
        for other in shares[1:]:
            np.testing.assert_array_equal(other, shares[0])
        with Tracer(mesh, device=session.info) as tracer:
            plain = tracer.ambient_occlusion(points, normals, rays=100, seed=3)
        # The same rays, from start points that are rounded in other units.
        np.testing.assert_allclose(shares[0], plain, rtol=0, atol=0.02)

    def test_the_order_on_the_device_does_not_matter(self, session, grooved):
        mesh, points, normals = grooved
        many = np.tile(points, (8, 1))[:5000], np.tile(normals, (8, 1))[:5000]
        with Tracer(mesh, device=session.info) as tracer:
            sorted_shares = tracer.ambient_occlusion(*many, rays=4)
            np.testing.assert_array_equal(sorted_shares[:700], tracer.ambient_occlusion(points, normals, rays=4))

    def test_seeds_draw_other_rays(self, session, grooved):
        mesh, points, normals = grooved
        with Tracer(mesh, device=session.info) as tracer:
            first, same, other = (tracer.ambient_occlusion(points, normals, seed=seed) for seed in (1, 1, 2))
        np.testing.assert_array_equal(first, same)
        assert (first != other).any()
        assert abs(first.mean() - other.mean()) < 2e-3

    def test_rays_are_no_multiple_of_those_drawn_at_once(self, session):
        with Tracer(disk_at(1.0, 1.0), device=session.info) as tracer:
            for rays in (1, 3, 63, 65, 100):
                share = tracer.ambient_occlusion([0, 0, 0], UP, rays=rays) * rays
                assert share == pytest.approx(round(share), abs=1e-9)
                assert abs(share / rays - 0.5) <= 2 / np.sqrt(rays)


class TestArguments:
    @pytest.fixture
    def tracer(self, session):
        with Tracer(disk_at(1.0, 1.0), device=session.info) as tracer:
            yield tracer

    def test_points_and_normals_are_broadcast(self, tracer):
        points, normals = np.zeros((4, 1, 3)), np.broadcast_to(UP, (3, 3))
        shares = tracer.ambient_occlusion(points, normals, max_distance=[2, 2, 0.5])
        assert shares.shape == (4, 3)
        assert shares.dtype == np.float64
        assert (shares[:, 2] == 1).all()
        assert (shares[:, :2] < 1).all()
        assert tracer.ambient_occlusion([0, 0, 0], UP).shape == ()
        assert tracer.ambient_occlusion(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)

    def test_masks(self, tracer, session):
        shares = tracer.ambient_occlusion(np.zeros((2, 3)), UP, mask=[0, 1])
        assert shares[0] == 1
        assert shares[1] < 1
        scene = clbvh.Scene()
        scene.place(scene.add(disk_at(1.0, 1.0)), mask=2)
        with Tracer(scene, device=session.info) as of_scene:
            np.testing.assert_array_equal(of_scene.ambient_occlusion(np.zeros((2, 3)), UP, mask=[1, 2]), shares)

    def test_far_away_everything_is_open(self, tracer):
        points = [[1e10, 0, 0], [0, -1e30, 0], [1e300, 1e300, 1e300]]
        np.testing.assert_array_equal(tracer.ambient_occlusion(points, [-1, 0, 0]), 1)

    def test_normals_of_any_length(self, tracer):
        shares = tracer.ambient_occlusion(np.zeros((3, 3)), [[0, 0, 1e-300], [0, 0, 1], [0, 0, 1e300]])
        assert (shares > 0.3).all()
        assert (shares < 0.7).all()

    @pytest.mark.parametrize(
        ("points", "normals", "named", "message"),
        [
            ([[0, 0, 0], [0, np.nan, 0]], UP, {}, r"points\[1\] is not finite"),
            ([0, 0, np.inf], UP, {}, "points is not finite"),
            (np.zeros((2, 3)), [UP, [0, -np.inf, 1]], {}, r"normals\[1\] is not finite"),
            (np.zeros((2, 3)), [0, np.inf, 0], {}, "normals is not finite"),
            (np.zeros((2, 3)), np.ones((3, 3)), {}, "broadcast"),
            (np.zeros((2, 2)), UP, {}, "points must have shape"),
            (np.zeros(3), UP, {"max_distance": -1}, "max_distance must be a number from 0"),
            (np.zeros(3), UP, {"max_distance": np.nan}, "max_distance must be a number from 0"),
            (np.zeros((2, 3)), UP, {"max_distance": [1, 2, 3]}, "that of the points"),
            (np.zeros(3), UP, {"offset": -1.0}, "offset must be a number from 0"),
            (np.zeros(3), UP, {"offset": np.nan}, "offset must be a number from 0"),
        ],
    )
    def test_bad_values_are_named(self, tracer, points, normals, named, message):
        with pytest.raises(QueryError, match=message):
            tracer.ambient_occlusion(points, normals, **named)

    @pytest.mark.parametrize("in_scene", [False, True])
    def test_a_point_without_a_normal_is_open_with_a_warning(self, session, in_scene):
        """Two loose vertices of an open box, and one whose faces cancel each other."""
        mesh = Mesh.from_arrays([*BOX.vertices, [0, 0, 0], [0, 0, 0.1]], [*BOX.faces, BOX.faces[0][::-1]])
        normals = -mesh.vertex_normals
        normals[-1] = 0
        with Tracer(scene_of(mesh) if in_scene else mesh, device=session.info) as tracer:
            with pytest.warns(clbvh.ClbvhWarning, match="^2 of 10 normals are NaN or zero"):
                shares = tracer.ambient_occlusion(mesh.vertices, normals)
            assert (shares == 1).tolist() == [False] * 8 + [True] * 2
            with pytest.warns(clbvh.ClbvhWarning, match="^3 of 3 "):
                np.testing.assert_array_equal(tracer.ambient_occlusion(np.zeros((3, 3)), [0, 0, 0]), 1)

    @pytest.mark.parametrize("named", [{"rays": 0}, {"rays": 1.5}, {"rays": True}, {"seed": -1}, {"seed": 2**32}])
    def test_bad_sampling_is_named(self, tracer, named):
        with pytest.raises(ConfigError, match="must be an integer from"):
            tracer.ambient_occlusion([0, 0, 0], UP, **named)

    def test_progress_counts_points(self, tracer):
        calls = []
        tracer.ambient_occlusion(np.zeros((10, 3)), UP, progress=lambda *counts: calls.append(counts))
        assert calls == [(10, 10)]

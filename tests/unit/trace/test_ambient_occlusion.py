"""Ambient occlusion against form factors, and points on surfaces that must not see what they lie on."""

import re

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import ConfigError, Mesh, QueryError, Spheres, Tracer, Transform, make_shape
from clbvh.geometry import as_mesh
from clbvh.trace.points import ambient_occlusion as query
from clbvh.tree_layouts import TREE_LAYOUTS

from .scene_states import affine, random_linear, turn

UP = [0.0, 0.0, 1.0]
TURN = turn(0, 0.7) @ turn(1, 2.1) @ turn(2, 4.0)
# Scrambled points in 1,024 cells: the error of a share is that of the cells on an edge, some tens of them.
RAYS, ERROR = 1024, 8e-3


def disk_at(height, radius=1.0, corners=720):
    """A disk around the z axis."""
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.column_stack((radius * np.cos(angles), radius * np.sin(angles), np.full(corners, height)))
    faces = [[corners, i, (i + 1) % corners] for i in range(corners)]
    return Mesh.from_arrays(np.vstack((rim, [[0, 0, height]])), faces)


def make_box():
    return as_mesh(trimesh.creation.box((1.0, 0.8, 0.6)))


def scene_of(*shapes):
    scene = clbvh.Scene()
    for shape, transform in shapes:
        scene.place(scene.add(shape), transform)
    return scene


def points_on(mesh, seed, spread=0.3):
    """300 points on a mesh, below a spread of 1 often close to edges, with the outer normals of a convex mesh."""
    generator = np.random.default_rng(seed)
    a, b, c = mesh.vertices[mesh.faces[generator.integers(0, mesh.face_count, 300)]].transpose(1, 0, 2)
    shares, normals = generator.dirichlet([spread] * 3, 300), np.cross(b - a, c - a)
    outwards = np.einsum("ij,ij->i", normals, a - mesh.vertices.mean(axis=0)) >= 0
    return np.einsum("ij,jik->ik", shares, np.stack((a, b, c))), np.where(outwards[:, None], normals, -normals)


@pytest.fixture
def share(session):
    """A function from a source and the arguments of the query to what it finds."""

    def find(source, *arguments, **named):
        with Tracer(source, device=session.info) as tracer:
            return tracer.ambient_occlusion(*arguments, **named)

    return find


def test_open_shares_are_those_of_the_form_factors(share):
    for height in (0.2, 1.0, 3.0):
        found = share(disk_at(height), [0, 0, 0], UP, rays=RAYS)
        assert found == pytest.approx(1 - 1 / (1 + height**2), abs=ERROR)
    # Above the horizon, that of a sphere is (radius / distance)^2 cos(angle).
    for angle in np.radians([0, 60]):
        ball = Spheres([[2.5 * np.sin(angle), 0, 2.5 * np.cos(angle)]], 1.0)
        found = share(scene_of((disk_at(0.0, 50), np.eye(4)), (ball, np.eye(4))), [0, 0, 0], UP, rays=RAYS)
        assert found == pytest.approx(1 - np.cos(angle) / 2.5**2, abs=ERROR)

    # Within 1.2, the disk hides the cone to the ring at that distance, of which the cosine is 1 / 1.2.
    found = share(disk_at(1.0), np.zeros((4, 3)), UP, rays=RAYS, max_distance=[0.5, 0.99, 1.2, np.inf])
    np.testing.assert_allclose(found, [1, 1, 1 / 1.2**2, 0.5], atol=ERROR)


@pytest.mark.parametrize(("unit", "away"), [(1, 0), (1e-30, 0), (1e30, 0), (1, 1e3), (1, 1e9)])
def test_points_on_convex_bodies_see_all_of_the_sky(share, unit, away):
    """Whatever rounds their coordinates."""
    for shape, flatness in ((make_box(), 1e-3), (make_shape("icosphere", triangles=1280), 1)):
        vertices = shape.vertices * [1, 1, flatness] @ TURN.T + away * np.array([1, -2, 0.5])
        mesh = Mesh.from_arrays(unit * vertices, shape.faces)
        points, normals = points_on(mesh, seed=4)
        for dtype in (np.float32, np.float64):
            assert (share(mesh, points.astype(dtype), normals / unit**2, rays=32) == 1).all()


@pytest.mark.parametrize("away", [0.0, 1e4])
def test_points_on_instances_see_all_of_the_sky(share, away):
    ball = make_shape("icosphere", triangles=1280)
    for seed in range(4):
        generator = np.random.default_rng(seed)
        transform = affine(random_linear(generator, stretch=10.0), away * generator.normal(size=3))
        world = Mesh.from_arrays(ball.vertices @ transform[:3, :3].T + transform[:3, 3], ball.faces)
        assert (share(scene_of((ball, transform)), *points_on(world, seed), rays=32) == 1).all()
    normals = generator.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    balls = scene_of((Spheres([[0, 0, 0], [1e3, 0, 0]], 1.0), affine(3.0 * TURN, (away, 200, -50))))
    for side, expected in ((1, 1), (-1, 0)):
        assert (share(balls, 3 * normals + [away, 200, -50], side * normals, rays=32) == expected).all()


def test_points_are_lifted_by_the_size_of_what_they_lie_on(share):
    box = make_box()
    # Not at the edges: there, rounding may lead out through the neighbour.
    points, normals = points_on(box, seed=8, spread=3.0)
    scene = scene_of((disk_at(0.0, 1.0), affine(offset=(0, 0, -1))), (box, affine(linear=[1e-5] * 3)))
    assert (share(scene, 1e-5 * points, -normals, rays=32) == 0).all()
    # Beside a small body on large ground: 10^-5 of the ground's size.
    scene = scene_of((disk_at(0.0, 1.0), np.eye(4)), (box, Transform(scale=0.01)))
    assert share(scene, [0.00505, 0, 0], UP, rays=RAYS) < 0.6
    below = [0.1, 0.2, -1e-3]
    assert share(disk_at(0.0, 1), below, UP, rays=RAYS) < 0.01
    assert share(disk_at(0.0, 1), below, UP, rays=RAYS, offset=1.1e-3) == 1


def test_layouts_cuts_and_orders_agree_and_seeds_do_not(open_tracer, source, mesh, monkeypatch):
    points, normals = points_on(mesh, seed=7)
    expected = open_tracer(source).ambient_occlusion(points, normals, rays=100, seed=3)
    assert len(np.unique(expected)) > 10
    for layout in TREE_LAYOUTS:
        found = open_tracer(source, layout=layout).ambient_occlusion(points, normals, rays=100, seed=3)
        np.testing.assert_array_equal(found, expected)
    ask = open_tracer(source).ambient_occlusion
    assert (ask(points, normals, rays=100, seed=4) != expected).any()
    for least in (query._LEAST_POINTS, 100):
        monkeypatch.setattr(query, "_LAUNCH_RAYS", 1000)
        monkeypatch.setattr(query, "_LEAST_POINTS", least)
        np.testing.assert_array_equal(ask(points, normals, rays=100, seed=3), expected)


def test_arguments_are_broadcast_scaled_and_masked(share):
    disk, progress = disk_at(1.0), []
    shares = share(disk, np.zeros((4, 1, 3)), np.broadcast_to(UP, (3, 3)), max_distance=[2, 2, 0.5],
                   progress=lambda *counts: progress.append(counts))  # fmt: skip
    assert progress == [(12, 12)]
    assert (shares == 1).tolist() == [[False, False, True]] * 4
    assert share(disk, [0, 0, 0], UP).shape == ()
    assert share(disk, np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    shares = share(disk, np.zeros((3, 3)), [[0, 0, 1e-300], [0, 0, 1], [0, 0, 1e300]])
    np.testing.assert_allclose(shares, 0.5, atol=0.2)
    scene = clbvh.Scene()
    scene.place(scene.add(disk), mask=2)
    for source, mask in ((disk, [0, 1]), (scene, [1, 2])):
        assert (share(source, np.zeros((2, 3)), UP, mask=mask) == 1).tolist() == [True, False]


def test_bad_values_are_named(share):
    points, one = np.zeros((2, 3)), [0, 0, 0]
    for error, at, normals, named, message in (
        (QueryError, [one, [0, np.nan, 0]], UP, {}, "points[1] is not finite"),
        (QueryError, points, [UP, [0, -np.inf, 1]], {}, "normals[1] is not finite"),
        (QueryError, one, UP, {"max_distance": -1}, "max_distance must be a number from 0"),
        (QueryError, points, UP, {"max_distance": [1, 2, 3]}, "that of the points"),
        (QueryError, one, UP, {"offset": np.nan}, "offset must be a number from 0"),
        (ConfigError, one, UP, {"rays": 0}, "must be an integer from"),
    ):
        with pytest.raises(error, match=re.escape(message)):
            share(disk_at(0.0, 1), at, normals, **named)


def test_a_point_without_a_normal_is_open_with_a_warning(share):
    """Two loose vertices of an open box, and one whose faces cancel each other."""
    box = make_box()
    mesh = Mesh.from_arrays([*box.vertices, [0, 0, 0], [0, 0, 0.1]], [*box.faces, box.faces[0][::-1]])
    normals = -mesh.vertex_normals
    normals[-1] = 0
    with pytest.warns(clbvh.ClbvhWarning, match="^2 of 10 normals are NaN or zero"):
        shares = share(mesh, mesh.vertices, normals)
    assert (shares == 1).tolist() == [False] * 8 + [True] * 2

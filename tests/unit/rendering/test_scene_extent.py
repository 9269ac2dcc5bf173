"""The extent of a scene against that of all its vertices and spheres in one array."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, Spheres, make_shape
from clbvh.rendering.cameras import bounds as scene_extent
from clbvh.rendering.cameras.bounds import Reaches, SceneBounds
from clbvh.rendering.cameras.framing import frame_mesh, frame_scene

from .test_camera import project

KNOT = make_shape("knot", triangles=2000)
SHAPES = [
    make_shape("icosphere", triangles=320),
    KNOT,
    Mesh.from_arrays([[3, 0, 0], [4, 0, 0], [3, 1, 0]], [[0, 1, 2]]),
]


def random_places(count, seed, spread=5.0):
    """The shape and the transform of each instance: any affine map, mirrors among them."""
    generator = np.random.default_rng(seed)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, :3] = generator.normal(size=(count, 3, 3)) * generator.uniform(0.1, 1, (count, 1, 1))
    transforms[:, :3, 3] = spread * generator.normal(size=(count, 3))
    return generator.integers(0, len(SHAPES), count), transforms


def flatten(geometry_ids, transforms):
    """(n, 3) float64: all vertices in the scene."""
    return np.concatenate(
        [
            SHAPES[geometry].vertices @ matrix[:3, :3].T + matrix[:3, 3]
            for geometry, matrix in zip(geometry_ids, transforms, strict=True)
        ]
    )


def box_of(extent):
    return extent.origin + extent.local_box / extent.scale


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [1, 7, 300])
def test_the_box_is_that_of_all_vertices(count, seed):
    geometry_ids, transforms = random_places(count, seed)
    points = flatten(geometry_ids, transforms)
    extent = SceneBounds(SHAPES, geometry_ids, transforms)
    np.testing.assert_allclose(box_of(extent), [points.min(axis=0), points.max(axis=0)], rtol=0, atol=1e-12 * 100)
    mesh = Mesh.from_arrays(points, [[0, 1, 2]])
    assert extent.scale == mesh.scale
    np.testing.assert_allclose(extent.origin, mesh.origin, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("up", [(0, 1, 0), (0.2, 1, -0.4)])
@pytest.mark.parametrize("turns", [False, True])
def test_the_camera_is_that_of_one_mesh(turns, up, seed):
    places = random_places(60, seed)
    mesh = Mesh.from_arrays(flatten(*places), [[0, 1, 2]])
    expected = frame_mesh(mesh, aspect=1.5, up=up, turns=turns)
    camera = frame_scene(SceneBounds(SHAPES, *places), aspect=1.5, up=up, turns=turns)
    # Those of the mesh are rounded to float32.
    size = 1 / mesh.scale
    np.testing.assert_allclose(camera.eye, expected.eye, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(camera.look_at, expected.look_at, rtol=0, atol=1e-6 * size)


@pytest.mark.parametrize("scale", [1e-100, 1e-20, 1e20, 1e100])
def test_neither_size_nor_place_matters(scale):
    geometry_ids, transforms = random_places(20, 3)
    plain = frame_scene(SceneBounds(SHAPES, geometry_ids, transforms), aspect=1.5)
    moved = transforms.copy()
    moved[:, :3, 3] += [5e5, -4e6, 120.0]
    moved[:, :3] *= scale
    camera = frame_scene(SceneBounds(SHAPES, geometry_ids, moved), aspect=1.5)
    np.testing.assert_allclose(np.divide(camera.eye, scale) - [5e5, -4e6, 120.0], plain.eye, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stretch", [1.0, 0.3])
def test_spheres_reach_as_far_as_their_surface(stretch, seed):
    generator = np.random.default_rng(seed)
    spheres = Spheres(generator.normal(size=(30, 3)), generator.uniform(0.1, 2, 30))
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(generator.normal(size=(3, 3)))[0] @ np.diag([1, stretch, 1])
    matrix[:3, 3] = [7, 8, 9]
    normals = generator.normal(size=(5000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = (spheres.centres[:, None] + spheres.radii[:, None, None] * normals).reshape(-1, 3)
    points = points @ matrix[:3, :3].T + matrix[:3, 3]
    extent = SceneBounds([spheres], np.array([0]), matrix[None])
    np.testing.assert_allclose(box_of(extent), [points.min(axis=0), points.max(axis=0)], rtol=0, atol=1e-2)

    places, depth = project(frame_scene(extent, aspect=1.5), points, 1.5)
    assert (depth > 0).all()
    assert 0.925 < np.abs(places).max() < 0.9401
    first = frame_scene(extent, aspect=1.5, turns=True)
    turned = [np.abs(project(first.orbit(angle), points, 1.5)[0]).max() for angle in np.arange(0, 360, 45)]
    assert max(turned) < 0.9401
    # A stretched sphere counts as one around it.
    assert max(turned) > (0.92 if stretch == 1 else 0.7)


def test_without_time_for_all_vertices_the_boxes_count(monkeypatch):
    places = random_places(50, 1)
    exact = box_of(SceneBounds(SHAPES, *places))
    monkeypatch.setattr(scene_extent, "_MOST_POINTS", -10_000_000)
    loose = box_of(SceneBounds(SHAPES, *places))
    assert (loose[0] <= exact[0]).all()
    assert (loose[1] >= exact[1]).all()
    assert (loose != exact).any()
    assert (np.ptp(loose, axis=0) < 2 * np.ptp(exact, axis=0)).all()


def test_few_of_many_instances_are_read(monkeypatch):
    read, reach_of = [], SceneBounds._reach_of
    monkeypatch.setattr(SceneBounds, "_reach_of", lambda *arguments: read.append(1) or reach_of(*arguments))
    places = random_places(2000, 2, spread=50.0)
    points = flatten(*places)
    np.testing.assert_allclose(
        box_of(SceneBounds(SHAPES, *places)), [points.min(axis=0), points.max(axis=0)], rtol=0, atol=1e-10
    )
    assert 6 <= len(read) < 60


def test_a_point_has_an_extent_of_nothing():
    dot = Mesh.from_arrays([[1, 2, 3]], [[0, 0, 0]])
    extent = SceneBounds([dot], np.array([0]), np.eye(4)[None])
    np.testing.assert_array_equal(box_of(extent), [[1, 2, 3], [1, 2, 3]])
    assert np.isfinite(frame_scene(extent, aspect=1).eye).all()


def test_the_box_in_another_space():
    extent = SceneBounds([KNOT], np.array([0]), np.diag([2.0, 2, 2, 1])[None])
    other = Mesh.from_arrays([[-40, 0, 0], [40, 3, 0], [0, 9, 9]], [[0, 1, 2]])
    np.testing.assert_allclose(extent.box_in(other), other.to_local(box_of(extent)), atol=1e-15)


def test_a_ball_reaches_at_most_as_far_as_is_said():
    generator = np.random.default_rng(5)
    axis = np.array([0.0, 0.6, 0.8])
    reaches = Reaches(np.outer(generator.normal(size=6), axis), generator.uniform(0, 1, 6), axis)
    linear = generator.normal(size=(3, 3))
    points = generator.normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    assert (reaches.of_points(points, linear, np.zeros(3)).max(axis=1) <= reaches.of_ball(linear)).all()
    straight = Reaches(generator.normal(size=(6, 3)), np.zeros(6), axis)
    np.testing.assert_allclose(
        straight.of_points(points, linear, np.zeros(3)).max(axis=1), straight.of_ball(linear), rtol=1e-2
    )

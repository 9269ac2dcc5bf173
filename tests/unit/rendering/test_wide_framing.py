"""Framing for orthographic, fisheye and panoramic cameras."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Fisheye, Mesh, Orthographic, Panorama, SceneError, Spheres, View
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.cameras.framing import frame_mesh, frame_scene
from clbvh.rendering.view_finder import ViewFinder

HEIGHT = 100
MARGIN = 0.06


def mesh_of(points):
    """A mesh with these vertices; its triangle does not matter."""
    return Mesh.from_arrays(points, [[0, 0, 0]])


def cloud(seed, scale=1.0):
    return (np.random.default_rng([9, seed]).normal(size=(300, 3)) * [3, 1, 0.4] + [7, 8, 9]) * scale


def camera_of(mesh, **settings):
    """The camera that a view of a mesh chooses."""
    finder = ViewFinder(SceneBounds.of_mesh(mesh))
    return finder.camera(finder.complete(View(**settings)))


def places(camera, points, aspect):
    """Places in the picture, -1 to 1 from edge to edge, and the depths."""
    pixels, depth = camera.project(points, round(HEIGHT * aspect), HEIGHT)
    return pixels / [HEIGHT * aspect / 2, HEIGHT / 2] - 1, depth


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("aspect", [2.0, 0.5])
@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1)])
def test_an_orthographic_camera_sees_every_point_and_wastes_no_room(seed, aspect, up):
    points = cloud(seed)
    found, depth = places(frame_mesh(mesh_of(points), aspect=aspect, up=up, projection=Orthographic()), points, aspect)
    assert (depth > 0).all()
    assert np.abs(found).max() == pytest.approx(1 - MARGIN, abs=1e-6)
    # The points are in the middle, along both directions.
    np.testing.assert_allclose(found.max(axis=0) + found.min(axis=0), 0, atol=1e-5)


def test_an_orthographic_camera_keeps_its_height():
    points = cloud(0)
    camera = frame_mesh(mesh_of(points), aspect=1, projection=Orthographic(50))
    assert camera.projection == Orthographic(50)
    found, _ = places(camera, points, 1)
    np.testing.assert_allclose(found.max(axis=0) + found.min(axis=0), 0, atol=1e-5)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("projection", [Orthographic(), Fisheye(150), Panorama()])
def test_framing_does_not_depend_on_scale(projection, scale):
    expected = places(frame_mesh(mesh_of(cloud(1)), aspect=1.5, projection=projection), cloud(1), 1.5)[0]
    camera = frame_mesh(mesh_of(cloud(1, scale)), aspect=1.5, projection=projection)
    np.testing.assert_allclose(places(camera, cloud(1, scale), 1.5)[0], expected, atol=1e-6)


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.array([[0, 0, 0], [0, 1, 0.0]]), np.eye(3)])
@pytest.mark.parametrize("projection", [Orthographic(), Fisheye(), Panorama()])
def test_points_without_extent_are_framed_too(projection, points):
    camera = frame_mesh(mesh_of(points), aspect=1, projection=projection)
    directions = camera.rays(8, 8)[1]
    assert np.isfinite(directions).all()
    if not isinstance(projection, Panorama):
        assert np.abs(places(camera, points, 1)[0]).max() < 1


@pytest.mark.parametrize("angle", [5, 60, 180, 360])
def test_a_fisheye_sees_every_point(angle):
    points = cloud(2)
    found, _ = places(frame_mesh(mesh_of(points), aspect=1.5, projection=Fisheye(angle)), points, 1.5)
    assert np.hypot(found[:, 0] * 1.5, found[:, 1]).max() < 1
    # They fill much of the circle.
    assert np.abs(found).max() > 0.08


def test_a_panorama_stands_in_the_middle_and_looks_level():
    points = cloud(3)
    for up in ((0, 1, 0), (0, 0, 2)):
        camera = frame_mesh(mesh_of(points), aspect=2, up=up, projection=Panorama())
        np.testing.assert_allclose(camera.eye, (points.min(axis=0) + points.max(axis=0)) / 2, rtol=1e-6)
        assert abs(np.subtract(camera.look_at, camera.eye) @ np.asarray(up)) < 1e-12
        assert np.isfinite(places(camera, points, 2)[0]).all()


@pytest.mark.parametrize("aspect", [2.0, 0.5])
@pytest.mark.parametrize("projection", [Orthographic(), Fisheye(120)])
def test_a_turn_sees_every_point_from_all_sides(projection, aspect):
    points = cloud(4)
    first = frame_mesh(mesh_of(points), aspect=aspect, up=(0.2, 1, -0.4), projection=projection, turns=True)
    seen = [places(first.orbit(angle), points, aspect) for angle in range(0, 360, 2)]
    reach = np.abs(np.concatenate([found for found, _ in seen]))
    assert min(depth.min() for _, depth in seen) > 0
    if isinstance(projection, Orthographic):
        assert reach.max() == pytest.approx(1 - MARGIN, abs=2e-3)
    else:
        assert np.hypot(reach[:, 0] * max(aspect, 1), reach[:, 1] / min(aspect, 1)).max() < 1


def test_a_panorama_has_no_turn():
    with pytest.raises(SceneError, match="no turn"):
        frame_mesh(mesh_of(cloud(0)), aspect=1, projection=Panorama(), turns=True)


def test_a_scene_of_several_objects_is_framed():
    spheres = Spheres([[0, 0, 0], [4, 0, 0]], [1.0, 0.5])
    extent = SceneBounds([spheres], np.array([0, 0]), np.stack((np.eye(4), np.diag([1, 2, 1, 1.0]))))
    camera = frame_scene(extent, aspect=1, projection=Orthographic())
    sphere = np.random.default_rng(0).normal(size=(2000, 3))
    sphere *= [1, 2, 1] / np.linalg.norm(sphere, axis=1, keepdims=True)
    found = np.abs(places(camera, np.concatenate((sphere, sphere * 0.5 + [4, 0, 0])), 1)[0])
    assert 0.9 < found.max() <= 1 - MARGIN + 1e-9


def test_an_eye_of_ones_own_gets_the_height_that_shows_everything():
    points = cloud(5)
    for given in ({"eye": (20, 30, 40)}, {"eye": (20, 30, 40), "look_at": (6, 8, 9)}):
        camera = camera_of(mesh_of(points), projection=Orthographic(), width=150, height=100, **given)
        assert camera.eye == (20, 30, 40)
        found, _ = places(camera, points, 1.5)
        assert np.abs(found).max() == pytest.approx(1 - MARGIN, abs=1e-5)


@pytest.mark.parametrize("given", [{}, {"eye": (20, 30, 40)}, {"eye": (20, 30, 40), "look_at": (6, 8, 9)}])
@pytest.mark.parametrize("projection", [None, Orthographic(3), Fisheye(), Panorama()])
def test_a_view_gives_its_camera_the_projection_and_the_lens(projection, given):
    mesh = mesh_of(cloud(6))
    assert camera_of(mesh, projection=projection, **given).projection == projection
    if projection is None or isinstance(projection, Orthographic):
        camera = camera_of(mesh, projection=projection, aperture=0.5, focus_distance=4, **given)
        assert (camera.aperture, camera.focus_distance, camera.projection) == (0.5, 4, projection)

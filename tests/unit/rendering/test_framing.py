"""Framing: cameras that see the whole of a mesh or a scene from any side, and waste no room."""

import numpy as np
import pytest

import clbvh
from clbvh import Fisheye, Mesh, Orthographic, Panorama, SceneError, View
from clbvh.choices import STANDARD_VIEWS
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.cameras.framing import frame_mesh, frame_scene
from clbvh.rendering.kernel_view import sky_direction
from clbvh.rendering.view_finder import ViewFinder

HEIGHT = 90
MARGIN = 0.06
SKEW = (0.2, 1, -0.4)


def cloud(seed, extents=(3, 1, 0.4), count=300):
    return np.random.default_rng([9, seed]).normal(size=(count, 3)) * extents + [7, 8, 9]


def mesh_of(points):
    """A mesh with these vertices; its triangle does not matter."""
    return Mesh.from_arrays(points, [[0, 0, 0]])


def places(camera, points, aspect):
    """Places in the picture, -1 to 1 from edge to edge, and the depths."""
    pixels, depth = camera.project(points, round(HEIGHT * aspect), HEIGHT)
    return pixels / [HEIGHT * aspect / 2, HEIGHT / 2] - 1, depth


def check_frame(camera, points, aspect):
    """Every point is seen; along one direction the points reach the margin on both sides; the other is centred."""
    found, depth = places(camera, points, aspect)
    assert (depth > 0).all()
    assert np.abs(found).max() <= 1 - MARGIN + 1e-5
    tight = np.argmax(np.ptp(found, axis=0))
    assert np.ptp(found, axis=0)[tight] > 1.85
    off_centre = np.abs(found.max(axis=0) + found.min(axis=0))
    assert off_centre[tight] < 1e-5
    assert off_centre.max() < 0.02


@pytest.mark.parametrize("projection", [None, Orthographic()])
def test_every_point_is_seen_and_no_room_is_wasted(projection):
    for seed, (aspect, up) in enumerate([(16 / 9, (0, 1, 0)), (0.5, (0, 0, 1)), (1.0, SKEW)]):
        for extents in ((3, 1, 0.4), (0.5, 4, 5)):
            points = cloud(seed, extents)
            check_frame(frame_mesh(mesh_of(points), aspect=aspect, up=up, projection=projection), points, aspect)


@pytest.mark.parametrize("projection", [None, Orthographic(), Fisheye(150), Panorama()])
def test_neither_scale_nor_place_nor_a_lack_of_extent_matters(projection):
    points = cloud(1)
    expected = places(frame_mesh(mesh_of(points), aspect=1.5, projection=projection), points, 1.5)[0]
    for scale in (1e-100, 1e100):
        moved = (points + np.array([5e5, -4e6, 120.0])) * scale
        camera = frame_mesh(mesh_of(moved), aspect=1.5, projection=projection)
        np.testing.assert_allclose(places(camera, moved, 1.5)[0], expected, atol=1e-6)
    for points in (np.zeros((1, 3)), np.array([[0, 0, 0], [0, 1, 0.0]]), np.eye(3)):
        camera = frame_mesh(mesh_of(points), aspect=1, projection=projection, turns=projection != Panorama())
        assert np.isfinite(camera.rays(8, 8)[1]).all()
        assert projection == Panorama() or np.abs(places(camera, points, 1)[0]).max() < 1


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 3), SKEW])
def test_a_turn_sees_every_point_from_all_sides(up):
    for aspect, projection in ((16 / 9, None), (0.5, None), (0.5, Orthographic()), (2.0, Fisheye(120))):
        for points in (cloud(4, (3, 1, 0.2), 60), cloud(4, (0.5, 4, 5), 60)):
            first = frame_mesh(mesh_of(points), aspect=aspect, up=up, projection=projection, turns=True)
            seen = [places(first.orbit(angle), points, aspect) for angle in range(0, 360, 2)]
            assert min(depth.min() for _, depth in seen) > 0
            found = np.concatenate([each for each, _ in seen])
            assert np.abs(found).max() < 1 - MARGIN + 1e-4
            # The pictures stay where they are: the line of sight goes through the axis.
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            assert np.linalg.norm(np.cross(np.subtract(first.look_at, centre), up)) < 1e-5
            if not isinstance(projection, Fisheye):
                tight = np.argmax(np.ptp(found, axis=0))
                assert found[:, tight].max() > 0.933
                assert found[:, tight].min() < -0.933


def test_a_panorama_stands_in_the_middle_looks_level_and_has_no_turn():
    points = cloud(3)
    for up in ((0, 1, 0), (0, 0, 2)):
        camera = frame_mesh(mesh_of(points), aspect=2, up=up, projection=Panorama())
        np.testing.assert_allclose(camera.eye, (points.min(axis=0) + points.max(axis=0)) / 2, rtol=1e-6)
        assert abs(np.subtract(camera.look_at, camera.eye) @ np.asarray(up)) < 1e-12
    with pytest.raises(SceneError, match="no turn"):
        frame_mesh(mesh_of(points), aspect=2, projection=Panorama(), turns=True)


@pytest.mark.parametrize("projection", [None, Orthographic(), Orthographic(3), Fisheye(), Panorama()])
def test_a_view_gives_its_camera_the_projection_the_lens_and_the_eye(projection):
    points = cloud(6)
    finder = ViewFinder(SceneBounds.of_mesh(mesh_of(points)))
    lens = {} if isinstance(projection, Fisheye | Panorama) else {"aperture": 0.5, "focus_distance": 4}
    size = {"width": 150, "height": 100}
    # The eye is beside the middle.
    for place in ({}, {"eye": (20, 30, 40)}, {"eye": (20, 30, 40), "look_at": (6, 8, 9)}):
        camera = finder.camera(finder.complete(View(projection=projection, **place, **lens, **size)))
        assert (camera.aperture, camera.focus_distance) == ((0.5, 4) if lens else (0, None))
        if "eye" in place:
            middle = tuple((points.min(axis=0) + points.max(axis=0)) / 2)
            assert camera.eye == place["eye"]
            assert camera.look_at == pytest.approx(place.get("look_at", middle))
        if projection == Orthographic():
            assert np.abs(places(camera, points, 1.5)[0]).max() == pytest.approx(1 - MARGIN, abs=1e-5)
        else:
            assert camera.projection == projection


@pytest.mark.parametrize(("up", "front"), [((0, 1, 0), (0, 0, 1)), ((0, 0, 2), (0, -1, 0))])
def test_a_standard_view_is_from_its_side(up, front):
    points, above, front = cloud(0), np.array(up) / np.linalg.norm(up), np.array(front)
    right = np.array((1, 0, 0))
    sides = {
        "front": front, "right": right, "back": -front, "left": -right, "top": above, "bottom": -above,
        "iso": (front + right + above) / np.sqrt(3),
    }  # fmt: skip
    assert tuple(sides) == STANDARD_VIEWS
    for side, towards in sides.items():
        camera = frame_mesh(mesh_of(points), aspect=1.5, up=up, side=side)
        np.testing.assert_allclose(-camera.axes()[2], towards, atol=1e-12)
        np.testing.assert_allclose(camera.up, {"top": -front, "bottom": front}.get(side, up))
        found, depth = places(camera, points, 1.5)
        assert depth.min() > 0
        assert 1.85 / 2 < np.abs(found).max() < 0.9401
        # The sky is above, also in the view from the top.
        assert (sky_direction(View(side=side, up=up), camera) == above).all()
    # The automatic view is from the front, a little from the right and above.
    towards = -frame_mesh(mesh_of(points), aspect=1, up=up).axes()[2]
    assert towards @ front > towards @ right > towards @ above > 0.2


def test_a_renderer_takes_one_side_after_the_other(mesh):
    size = {"width": 40, "height": 30, "shading": "normal"}
    with clbvh.Renderer(mesh, eye=(1, 2, 3), up="y", **size) as renderer:
        for side in ("top", "left"):
            camera = renderer.render(side=side).camera
            assert camera == frame_mesh(mesh, aspect=4 / 3, side=side)
        with pytest.raises(SceneError, match="'top' and a camera"):
            renderer.render(side="top", camera=camera)


def test_bounds_and_cameras_of_a_scene_are_those_of_all_its_vertices():
    shapes = [clbvh.make_shape("icosphere", triangles=320), clbvh.make_shape("knot", triangles=200), mesh_of(np.eye(3))]
    for count in (1, 7, 2000):
        generator = np.random.default_rng(count)
        transforms = np.tile(np.eye(4), (count, 1, 1))
        transforms[:, :3] = generator.normal(size=(count, 3, 4)) * [1, 1, 1, count / 40 + 5]
        ids = generator.integers(0, len(shapes), count)
        parts = [shapes[i].vertices @ place[:3, :3].T + place[:3, 3] for i, place in zip(ids, transforms, strict=True)]
        points, bounds = np.concatenate(parts), SceneBounds(shapes, ids, transforms)
        box = bounds.origin + bounds.local_box / bounds.scale
        np.testing.assert_allclose(box, [points.min(axis=0), points.max(axis=0)], rtol=0, atol=1e-10)
        check_frame(frame_scene(bounds, aspect=1.5, up=SKEW), points, 1.5)

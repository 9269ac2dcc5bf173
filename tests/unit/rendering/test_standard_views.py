"""Standard views: their sides, whatever is up, and the framing of the mesh from there."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.choices import STANDARD_VIEWS
from clbvh.errors import SceneError
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.cameras.framing import frame_mesh, frame_scene, measure_side
from clbvh.rendering.cameras.pose import find_sides
from clbvh.rendering.cameras.projection import Fisheye, Orthographic, Panorama
from clbvh.rendering.kernel_view import sky_direction

# Towards the camera, and up in the picture, where y is up and where z is.
SIDES = {
    (0, 1, 0): {
        "front": ((0, 0, 1), (0, 1, 0)),
        "right": ((1, 0, 0), (0, 1, 0)),
        "back": ((0, 0, -1), (0, 1, 0)),
        "left": ((-1, 0, 0), (0, 1, 0)),
        "top": ((0, 1, 0), (0, 0, -1)),
        "bottom": ((0, -1, 0), (0, 0, 1)),
        "iso": (np.ones(3) / np.sqrt(3), (0, 1, 0)),
    },
    (0, 0, 2): {
        "front": ((0, -1, 0), (0, 0, 2)),
        "right": ((1, 0, 0), (0, 0, 2)),
        "back": ((0, 1, 0), (0, 0, 2)),
        "left": ((-1, 0, 0), (0, 0, 2)),
        "top": ((0, 0, 1), (0, 1, 0)),
        "bottom": ((0, 0, -1), (0, -1, 0)),
        "iso": (np.array((1, -1, 1)) / np.sqrt(3), (0, 0, 2)),
    },
}
ASPECT = 1.5


def cloud(seed=0):
    return np.random.default_rng(seed).normal(size=(60, 3)) * (3, 1, 0.5) + (7, 8, 9)


def mesh_of(points):
    return clbvh.Mesh.from_arrays(points, np.arange(len(points)).reshape(-1, 3))


def project(camera, points):
    """Return the places of points in the picture, -1 to 1, and their depths."""
    right, up, forward = camera.axes()
    offsets = points - camera.eye
    depth = offsets @ forward
    half = depth * np.tan(np.radians(camera.fov) / 2)
    return np.stack((offsets @ right / half / ASPECT, offsets @ up / half), axis=1), depth


@pytest.mark.parametrize("up", SIDES)
@pytest.mark.parametrize("name", STANDARD_VIEWS)
def test_sides(name, up):
    towards, picture_up = find_sides(name, up)
    np.testing.assert_allclose(towards, SIDES[up][name][0], atol=1e-15)
    np.testing.assert_array_equal(picture_up, SIDES[up][name][1])


@pytest.mark.parametrize("name", STANDARD_VIEWS)
@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (0.2, 1, -0.4), (1e-30, 0, 0)])
def test_a_view_sees_every_point_from_its_side(name, up):
    points = cloud()
    camera = frame_mesh(mesh_of(points), aspect=ASPECT, up=up, side=name)
    places, depth = project(camera, points)
    assert depth.min() > 0
    assert np.abs(places).max() < 1
    assert np.ptp(places, axis=0).max() > 1.85
    np.testing.assert_allclose(-camera.axes()[2], find_sides(name, up)[0], atol=1e-12)


@pytest.mark.parametrize("name", STANDARD_VIEWS)
def test_a_scene_is_framed_as_its_mesh(name):
    mesh = mesh_of(cloud())
    shift = np.eye(4)
    shift[:3, 3] = 5, -3, 2
    extent = SceneBounds([mesh], np.zeros(1, np.int32), shift[None])
    for projection in (None, Orthographic()):
        view = {"aspect": ASPECT, "side": name, "projection": projection}
        np.testing.assert_allclose(
            frame_scene(extent, **view).eye - shift[:3, 3], frame_mesh(mesh, **view).eye, rtol=1e-5
        )


def test_without_a_side_the_camera_is_the_automatic_one():
    mesh = mesh_of(cloud())
    with clbvh.Renderer(mesh, up="y") as renderer:
        assert renderer.camera == frame_mesh(mesh, aspect=16 / 9)
        assert renderer.find_camera(side="left") == frame_mesh(mesh, aspect=16 / 9, side="left")


@pytest.mark.parametrize("name", ["top", "bottom"])
def test_a_panorama_looks_level(name):
    with pytest.raises(SceneError, match=f"another view than '{name}'"):
        frame_mesh(mesh_of(cloud()), aspect=2, side=name, projection=Panorama())
    frame_mesh(mesh_of(cloud()), aspect=2, side="left", projection=Panorama())
    frame_mesh(mesh_of(cloud()), aspect=2, side=name, projection=Fisheye(180.0))


def test_another_side_is_refused():
    with pytest.raises(SceneError, match="front, right, back, left, top, bottom, iso"):
        find_sides("None", (0, 1, 0))


def test_the_sky_of_a_view_from_the_top_is_above():
    camera = frame_mesh(mesh_of(cloud()), aspect=1, up=(0, 0, 3), side="top")
    assert sky_direction(clbvh.View(side="top", up=(0, 0, 3)), camera).tolist() == [0, 0, 1]


def test_a_renderer_takes_sides():
    mesh = clbvh.make_shape("icosphere", triangles=80)
    size = {"width": 40, "height": 30, "shading": "normal"}
    with clbvh.Renderer(mesh, eye=(1, 2, 3)) as renderer:
        top = renderer.render(side="top", **size)
        with pytest.raises(SceneError, match="'top' and a camera"):
            renderer.render(side="top", camera=top.camera)
    np.testing.assert_array_equal(top.rgb, clbvh.render(mesh, side="top", **size).rgb)


def test_scene_files_and_saved_scenes_keep_the_side(tmp_path):
    (tmp_path / "a.toml").write_text('[[object]]\nshape = "icosphere"\ntriangles = 80\n[view]\nside = "iso"\n')
    scene, view = clbvh.open_scene(tmp_path / "a.toml")
    assert view.side == "iso"
    clbvh.save_scene(tmp_path / "a.scene", scene, view)
    assert clbvh.open_scene(tmp_path / "a.scene")[1].side == "iso"


def test_sizes_are_those_of_the_box():
    points = cloud()
    across, high, deep = np.ptp(points, axis=0)
    bounds = SceneBounds.of_mesh(mesh_of(points))
    np.testing.assert_allclose(measure_side(bounds, "front"), (across, high), rtol=1e-6)
    np.testing.assert_allclose(measure_side(bounds, "left"), (deep, high), rtol=1e-6)
    np.testing.assert_allclose(measure_side(bounds, "top"), (across, deep), rtol=1e-6)

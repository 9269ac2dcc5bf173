"""A view as the device takes it."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import View
from clbvh.choices import SHADINGS
from clbvh.errors import SceneError
from clbvh.geometry import Mesh
from clbvh.rendering.cameras.camera import Camera
from clbvh.rendering.kernel_view import make_kernel_view

MESH = Mesh.from_arrays(np.array([[0, 0, 0], [4, 0, 0], [0, 2, 6.0]]) + 1e6, [[0, 1, 2]])
VIEW = View(width=200, height=100, up="y")
CAMERA = Camera((1e6 + 2, 1e6 + 1, 1e6 + 13), (1e6 + 2, 1e6 + 1, 1e6 + 3), fov=90)


def test_the_eye_is_in_local_coordinates():
    assert MESH.scale == 0.25
    assert np.allclose(make_kernel_view(VIEW, CAMERA, MESH)["eye"][0], [0, 0, 2.5])


def test_the_axes_span_the_picture():
    view = make_kernel_view(VIEW, CAMERA, MESH)
    assert np.allclose(view["forward"][0], [0, 0, -1])
    assert np.allclose(view["up"][0], [0, 1, 0])
    assert np.allclose(view["right"][0], [2, 0, 0])


def test_a_lens_off_centre_leans_the_middle_and_not_the_optical_axis():
    pose = CAMERA.camera_to_world()
    lens = Camera.from_intrinsics([[50, 10, 40], [0, 25, 75], [0, 0, 1]], pose, (200, 100))
    view = make_kernel_view(VIEW, lens, MESH)
    assert np.allclose(view["optical_axis"][0], [0, 0, -1])
    assert np.allclose(view["right"][0], [2, 0, 0])
    assert np.allclose(view["up"][0], [2 * 10 / 50, 2, 0])
    # The middle is 60 columns to the right of the principal point and 25 rows above it.
    assert np.allclose(view["forward"][0], [60 / 50 + 1 * 10 / 50, 1, -1])


def test_the_sky_of_a_lens_is_the_scenes_and_of_a_camera_its_own():
    view = VIEW.changed(up=(0, 0, 2))
    lens = Camera.from_intrinsics([[50, 0, 100], [0, 50, 50], [0, 0, 1]], CAMERA.camera_to_world(), (200, 100))
    assert np.allclose(make_kernel_view(view, lens, MESH)["to_sky"][0], [0, 0, 1])
    assert np.allclose(make_kernel_view(view, CAMERA, MESH)["to_sky"][0], [0, 1, 0])


def test_the_automatic_light_comes_from_the_viewers_left_and_above():
    to_light = make_kernel_view(VIEW, CAMERA, MESH)["to_light"][0]
    assert np.linalg.norm(to_light) == pytest.approx(1)
    assert to_light[0] < 0 < to_light[1]
    assert to_light[2] > 0


def test_a_light_of_ones_own_is_normalised():
    view = VIEW.changed(light_direction=(0, 3, 4))
    assert np.allclose(make_kernel_view(view, CAMERA, MESH)["to_light"][0], [0, 0.6, 0.8])


def test_depth_runs_over_the_meshs_box():
    view = make_kernel_view(VIEW, CAMERA, MESH)
    assert (view["depth_near"][0], view["depth_far"][0]) == (7 / 4, 13 / 4)


def test_depth_of_a_flat_mesh_is_a_range_all_the_same():
    flat = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    view = make_kernel_view(VIEW, Camera((0, 0, 3), (0, 0, 0)), flat)
    assert view["depth_near"][0] < view["depth_far"][0]


@pytest.mark.parametrize("shading", SHADINGS)
def test_the_shading_travels_as_its_number(shading):
    view = VIEW.changed(shading=shading)
    assert make_kernel_view(view, CAMERA, MESH)["shading"][0] == SHADINGS[shading]


@pytest.mark.parametrize("distance", [1e35, 1e200, 1.7e308])
def test_an_eye_beyond_float32_is_refused(distance):
    with pytest.raises(SceneError, match="sizes of the mesh away"):
        make_kernel_view(VIEW, Camera((distance, 0, 0), (0, 0, 0)), MESH)
    assert np.isfinite(make_kernel_view(VIEW, Camera((1e28, 0, 0), (0, 0, 0)), MESH)["eye"]).all()

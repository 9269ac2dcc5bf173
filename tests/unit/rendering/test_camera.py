"""The camera: its axes, its rays, and how it frames a mesh by itself."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.errors import SceneError
from clbvh.rendering.cameras.camera import Camera
from clbvh.rendering.cameras.framing import frame_mesh


def mesh_of(points):
    """A mesh with these vertices; its triangle does not matter."""
    return Mesh.from_arrays(points, [[0, 0, 0]])


def project(camera: Camera, points: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the points' places in the picture, -1 to 1 from edge to edge, and their depths."""
    right, up, forward = camera.axes()
    seen = points - np.asarray(camera.eye)
    depth = seen @ forward
    half_height = np.tan(np.radians(camera.fov) / 2)
    places = np.stack([seen @ right / aspect, seen @ up], axis=1) / depth[:, None] / half_height
    return places, depth


def test_axes_are_orthonormal_and_right_handed():
    right, up, forward = Camera((1, 2, 3), (4, -1, 0), up=(0, 5, 1)).axes()
    assert np.allclose(np.stack([right, up, forward]) @ np.stack([right, up, forward]).T, np.eye(3))
    assert np.allclose(np.cross(right, up), -forward)


def test_the_ray_through_the_centre_looks_at_the_target():
    camera = Camera((0, 0, 5), (0, 0, 0))
    origins, directions = camera.rays(3, 3)
    assert np.allclose(origins, [0, 0, 5])
    assert np.allclose(directions[1, 1], [0, 0, -1])


def test_row_0_is_the_top_and_column_0_the_left():
    directions = Camera((0, 0, 5), (0, 0, 0)).rays(2, 2)[1]
    assert directions[0, 0, 1] > 0 > directions[1, 0, 1]
    assert directions[0, 0, 0] < 0 < directions[0, 1, 0]


def test_rays_have_length_1_and_span_the_field_of_view():
    height = 1001
    directions = Camera((0, 0, 0), (0, 0, -1), fov=50).rays(1, height)[1]
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1)
    angle = np.degrees(np.arccos(directions[0, 0] @ directions[-1, 0]))
    assert angle == pytest.approx(50, abs=0.1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("aspect", [16 / 9, 0.5])
def test_the_automatic_camera_sees_every_point_and_wastes_no_room(seed, aspect):
    points = np.random.default_rng(seed).normal(size=(500, 3)) * [3, 1, 0.2]
    places, depth = project(frame_mesh(mesh_of(points), aspect=aspect), points, aspect)
    assert (depth > 0).all()
    assert np.abs(places).max() < 1
    # Along one direction the points reach the margin on both sides; along the other they are in the middle.
    tight = np.argmax(np.ptp(places, axis=0))
    off_centre = np.abs(places.max(axis=0) + places.min(axis=0))
    assert np.ptp(places, axis=0)[tight] > 1.85
    assert off_centre[tight] < 1e-6
    assert off_centre.max() < 0.02


@pytest.mark.parametrize("scale", [1e-100, 1e-36, 1e-6, 1.0, 1e8, 1e100])
def test_framing_does_not_depend_on_scale_or_place(scale):
    points = np.random.default_rng(1).normal(size=(100, 3))
    origin = np.array([5e5, -4e6, 120.0])
    plain = project(frame_mesh(mesh_of(points), aspect=1.5), points, 1.5)[0]
    camera = frame_mesh(mesh_of((points + origin) * scale), aspect=1.5)
    assert np.allclose(project(camera, (points + origin) * scale, 1.5)[0], plain, atol=1e-6)


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.array([[0, 0, 0], [0, 1, 0.0]]), np.eye(3)])
def test_points_without_extent_are_framed_too(points):
    places, depth = project(frame_mesh(mesh_of(points), aspect=1), points, 1)
    assert np.isfinite(places).all()
    assert (depth > 0).all()


def test_z_up_looks_from_the_front_of_a_z_up_model():
    points = np.random.default_rng(0).normal(size=(50, 3))
    camera = frame_mesh(mesh_of(points), aspect=1, up=(0, 0, 1))
    assert camera.eye[1] < 0 < camera.eye[2]


def test_an_eye_of_ones_own_looks_at_the_middle():
    camera = frame_mesh(mesh_of([[10, 0, 0], [12, 2, 2]]), aspect=1, eye=(0, 0, 9))
    assert camera.look_at == (11, 1, 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"eye": (1, 1, 1), "look_at": (1, 1, 1)}, "same point"),
        ({"eye": (0, 1, 0), "look_at": (0, 0, 0)}, "parallel"),
        ({"eye": (0, 0, 1), "look_at": (0, 0, 0), "up": (0, 0, 0)}, "up"),
        ({"eye": (0, 0, 1), "look_at": (0, 0, 0), "fov": 180}, "fov"),
        ({"eye": (0, 0, 1), "look_at": (0, 0, 0), "fov": float("nan")}, "fov"),
        ({"eye": (0, 0, float("inf")), "look_at": (0, 0, 0)}, "finite"),
    ],
)
def test_a_camera_that_cannot_see_is_refused(arguments, message):
    with pytest.raises(SceneError, match=message):
        Camera(**arguments)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("aspect", [16 / 9, 0.5])
@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 3), (0.2, 1, -0.4)])
@pytest.mark.parametrize("extents", [(3, 1, 0.2), (0.5, 4, 5)])
def test_a_turn_sees_every_point_from_all_sides_and_wastes_no_room(seed, aspect, up, extents):
    points = np.random.default_rng(seed).normal(size=(60, 3)) * extents + [7, 8, 9]
    first = frame_mesh(mesh_of(points), aspect=aspect, up=up, turns=True)
    seen = [project(first.orbit(angle), points, aspect) for angle in np.arange(360)]
    assert min(depth.min() for _, depth in seen) > 0
    places = np.concatenate([places for places, _ in seen])
    # Along one direction the points reach the margin on both sides.
    tight = np.argmax(np.ptp(places, axis=0))
    assert np.abs(places).max() < 0.9401
    assert places[:, tight].max() > 0.935
    assert places[:, tight].min() < -0.935
    # The pictures stay where they are: the line of sight goes through the axis.
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    axis = np.asarray(up) / np.linalg.norm(up)
    assert np.linalg.norm(np.cross(np.subtract(first.look_at, centre), axis)) < 1e-6


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.array([[0, 0, 0], [0, 1, 0.0]]), np.eye(3)])
def test_points_without_extent_are_framed_for_a_turn(points):
    camera = frame_mesh(mesh_of(points), aspect=1, turns=True)
    places, depth = project(camera.orbit(77), points, 1)
    assert np.isfinite(places).all()
    assert (depth > 0).all()

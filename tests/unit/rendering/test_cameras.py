"""Cameras: axes, rays, turns, values that no camera has, and files of cameras."""

import json
import math

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from clbvh import Camera, Lens, SceneError
from clbvh.rendering.images import read_camera

CAMERA = Camera((1.0, 2.0, 3.0), (0.0, 0.5, 0.0), up=(0, 2, 0), fov=40)
K = [[500.0, 1.0, 310.0], [0.0, 510.0, 250.0], [0.0, 0.0, 1.0]]
LENS_CAMERA = Camera.from_intrinsics(K, np.eye(4), (640, 480))
TOO_LONG = 10**400  # an integer that float64 cannot hold


def test_axes_are_orthonormal_and_right_handed_whatever_the_length_of_up():
    for length in (5e-324, 1e-310, 1.0, 1.7e308):
        right, up, forward = np.array(Camera((1, 2, 3), (4, -1, 0), up=(0, length, 0)).axes())
        assert_allclose([right @ up, right @ forward, up @ forward, right[1]], 0, atol=1e-15)
        assert_allclose([right @ right, up @ up, forward @ forward], 1)
        assert_allclose(np.cross(right, up), -forward, atol=1e-15)
        assert up[1] > 0


def test_rays_fill_the_field_of_view_from_the_upper_left_to_the_lower_right():
    origins, directions = Camera((0, 0, 5), (0, 0, 0), fov=90).rays(3, 3)
    assert (origins == [0, 0, 5]).all()
    assert_allclose(np.linalg.norm(directions, axis=-1), 1)
    slopes = directions[..., :2] / -directions[..., 2:]
    assert_allclose(slopes[0, :, 0], [-2 / 3, 0, 2 / 3], atol=1e-15)
    assert_allclose(slopes[:, 0, 1], [2 / 3, 0, -2 / 3], atol=1e-15)


def test_an_orbit_turns_counterclockwise_around_the_point_looked_at():
    assert_allclose(Camera((0, 0, 5), (0, 0, 0)).orbit(90).eye, [5, 0, 0], atol=1e-15)
    turned = CAMERA.orbit(33)
    assert (turned.look_at, turned.fov) == (CAMERA.look_at, 40)
    assert turned.eye[1] == pytest.approx(2, abs=1e-12)
    assert math.dist(turned.eye, turned.look_at) == pytest.approx(math.dist(CAMERA.eye, CAMERA.look_at))
    for turns in (1, -1, 10**9, 2.0**1000):
        assert CAMERA.orbit(360 * turns) == CAMERA
    # Or around an axis of one's own.
    turn = trimesh.transformations.rotation_matrix(np.radians(25), [0, 0, 1], [1, 2, 3])
    turned = LENS_CAMERA.orbit(25, about=(1, 2, 3), axis=(0, 0, 3))
    assert_allclose(turned.camera_to_world(), turn, atol=1e-12)


def test_what_is_no_camera_and_no_turn_is_refused():
    place, lens = {"eye": (0, 0, 1), "look_at": (0, 0, 0)}, LENS_CAMERA.lens
    rows = [
        (lambda: Camera(**place, fov=TOO_LONG), "fov must be"), (lambda: CAMERA.orbit(math.nan), "finite number"),
        (lambda: Camera((1, 1, 1), (1, 1, 1)), "same point"), (lambda: Camera((0, 1, 0), (0, 0, 0)), "parallel"),
        (lambda: Camera(**place, up=(0, 0, 0)), "up is zero"), (lambda: Camera((0, 0, math.inf), (0, 0, 0)), "finite"),
        (lambda: Camera((1e308, 0, 0), (-1e308, 0, 0)), "farther apart"),
        (lambda: Camera(**place, fov=60, lens=lens), "follows from its lens"),
        (lambda: Camera(**place).rays(), "has no size"), (lambda: CAMERA.rays(8, 6, range(4, 7)), "the rows of a picture"),
        (lambda: Camera(**place, aperture=0.1, lens=lens), "needs a focus_distance"),
        (lambda: Lens(TOO_LONG, 1, 0, 0, 0, 640, 480), "fx must be a finite number"),
        (lambda: CAMERA.orbit(90, axis=(0, 0, 0)), "must not be zero"), (lambda: LENS_CAMERA.orbit(25), "as `about`"),
    ]  # fmt: skip
    for call, words in rows:
        with pytest.raises(SceneError, match=words):
            call()


def test_a_file_has_the_camera_of_its_matrices(tmp_path):
    pose = [[1.0, 0, 0, 0.4], [0, 0.6, -0.8, 4.0], [0, 0.8, 0.6, -3.2], [0, 0, 0, 1.0]]
    facts = {"intrinsics": K, "camera_to_world": pose, "size": [640, 480]}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(facts | {"convention": "opengl", "pixel_centres": "integer", "more": {}}))
    assert read_camera(path) == Camera.from_intrinsics(K, pose, (640, 480), "opengl", pixel_centres="integer")
    missing, other = json.dumps({"size": [60, 40]}), json.dumps(facts | {"convention": "left"})
    rows = [(missing, "here is no"), (other, "must be one of"), ("[1]", "holds an object"), ("solid", "no JSON file")]
    for content, words in rows:
        path.write_text(content)
        with pytest.raises(SceneError, match=rf"a\.json: .*{words}"):
            read_camera(path)

"""Orthographic, fisheye and panoramic cameras: their rays by formula, the way back, and what is refused."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Fisheye, Lens, Orthographic, Panorama, SceneError
from clbvh.rendering.cameras.projection import read_projection, text_of

FRAME = {"eye": (3.0, 2.0, 5.0), "look_at": (0.5, -1.0, 0.0), "up": (0.1, 1.0, 0.2)}
LOOKING_DOWN_Z = {"eye": (0, 0, 0), "look_at": (0, 0, -1)}
K = [[90.0, 2.0, 44.0], [0, 85.0, 39.0], [0, 0, 1]]
POSE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 1], [0, 0, 0, 1]])
WIDTH, HEIGHT = 96, 72

CAMERAS = {
    "perspective": Camera(**FRAME),
    "lens": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT)),
    "distorted": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT), distortion=(-0.28, 0.11, 0.003, -0.004, -0.02)),
    "orthographic": Camera(**FRAME, projection=Orthographic(4)),
    "fisheye": Camera(**FRAME, projection=Fisheye(200)),
    "fisheye-full": Camera(**FRAME, projection=Fisheye(360)),
    "panorama": Camera(**FRAME, projection=Panorama()),
}
PROJECTIONS = [Orthographic(4), Fisheye(), Panorama()]


def seen_points(name, seed, count=300):
    """Points of the picture at which the camera sees something."""
    points = np.random.default_rng([5, seed]).uniform(0, (WIDTH, HEIGHT), (count, 2))
    if not name.startswith("fisheye"):
        return points
    return points[np.hypot(*(points - [WIDTH / 2, HEIGHT / 2]).T) < 0.999 * HEIGHT / 2]


@pytest.mark.parametrize("name", CAMERAS)
def test_a_point_on_a_ray_is_projected_to_where_the_ray_comes_from(name):
    camera, pixels = CAMERAS[name], seen_points(name, 0)
    origins, directions = camera.rays_at(pixels, WIDTH, HEIGHT)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=0, atol=1e-15)
    distances = np.random.default_rng(6).uniform(0.1, 1000, (len(pixels), 1))
    points = origins + distances * directions
    found, depth = camera.project(points, WIDTH, HEIGHT)
    np.testing.assert_allclose(found, pixels, rtol=0, atol=1e-8)
    np.testing.assert_allclose(depth, (points - camera.eye) @ camera.axes()[2], rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_of_a_picture_are_those_through_its_pixel_centres(name):
    camera = CAMERAS[name]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    expected = camera.rays_at(np.stack((columns, rows), axis=-1), WIDTH, HEIGHT)
    np.testing.assert_allclose(camera.rays(WIDTH, HEIGHT)[0], expected[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(camera.rays(WIDTH, HEIGHT)[1], expected[1], rtol=0, atol=1e-14)
    part = camera.rays(WIDTH, HEIGHT, range(3, 8))
    for of_rows, whole in zip(part, camera.rays(WIDTH, HEIGHT), strict=True):
        np.testing.assert_array_equal(of_rows, whole[3:8])


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_is_t_times_the_cosine(name):
    camera = CAMERAS[name]
    _, directions = camera.rays(WIDTH, HEIGHT)
    np.testing.assert_array_equal(camera.cosines(WIDTH, HEIGHT), directions @ camera.axes()[2])


def test_orthographic_rays_are_parallel_and_fill_the_height():
    camera = Camera(eye=(1, 2, 10), look_at=(1, 2, 0), projection=Orthographic(3))
    origins, directions = camera.rays(4, 2)
    assert (directions == [0, 0, -1]).all()
    assert origins[:, 0, 1].tolist() == [2.75, 1.25]
    assert origins[0, :, 0].tolist() == [1 - 2.25, 1 - 0.75, 1 + 0.75, 1 + 2.25]
    pixels, depth = camera.project([[1 + 3, 2 + 1.5, 4], [1, 2, 11]], 4, 2)
    assert pixels[0].tolist() == [4, 0]
    assert np.isnan(pixels[1]).all()
    assert depth.tolist() == [6, -1]


@pytest.mark.parametrize("angle", [1e-3, 90, 180, 270, 360])
def test_a_fisheye_is_equidistant(angle):
    camera = Camera(**LOOKING_DOWN_Z, projection=Fisheye(angle))
    radius = np.linspace(0, 1, 9)
    pixels = np.stack((100 + 50 * radius, np.full(9, 50.0)), axis=1)
    directions = camera.rays_at(pixels, 200, 100)[1]
    expected = np.radians(angle) / 2 * radius
    np.testing.assert_allclose(np.arctan2(directions[:, 0], -directions[:, 2]), expected, rtol=1e-9, atol=1e-15)
    assert np.abs(directions[:, 1]).max() < 1e-15


def test_a_fisheye_sees_the_inside_of_the_circle_that_touches_the_shorter_sides():
    for width, height in ((80, 60), (60, 80)):
        rows, columns = np.mgrid[:height, :width] + 0.5
        inside = np.hypot(columns - width / 2, rows - height / 2) <= 30
        np.testing.assert_array_equal(Camera(**FRAME, projection=Fisheye()).sees(width, height), inside)
    assert Camera(**FRAME).sees(3, 2).all()


def test_points_outside_a_fisheye_and_in_its_eye_have_no_pixel():
    camera = Camera(**LOOKING_DOWN_Z, projection=Fisheye(180))
    pixels, _ = camera.project([[0, 0, 1], [1, 0, 0.1], [0, 0, 0], [1, 0, 0]], 100, 100)
    assert np.isnan(pixels[:3]).all()
    assert pixels[3] == pytest.approx([100, 50])
    behind, depth = Camera(**LOOKING_DOWN_Z, projection=Fisheye(360)).project([0, 0, 1], 100, 100)
    assert behind == pytest.approx([100, 50])
    assert depth == -1


def test_a_panorama_has_longitudes_and_latitudes():
    camera = Camera(**LOOKING_DOWN_Z, projection=Panorama())
    points = [[0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 1, -1], [1, 0, -1]]
    pixels, _ = camera.project(np.array(points) * 7.0, 360, 180)
    expected = [[180, 90], [270, 90], [90, 90], [180, 0], [180, 180], [180, 45], [225, 90]]
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-12)
    assert np.isnan(camera.project([0, 0, 0], 360, 180)[0]).all()


def test_a_panorama_of_a_picture_sees_every_direction_once():
    directions = Camera(**FRAME, projection=Panorama()).rays(720, 360)[1]
    weights = np.sin((np.arange(360) + 0.5) * math.pi / 360)[:, None, None]
    assert np.abs((directions * weights).sum(axis=(0, 1)) / weights.sum() / 720).max() < 1e-12
    second = np.einsum("ijk,ijl,i->kl", directions, directions, weights[:, 0, 0]) / weights.sum() / 720
    np.testing.assert_allclose(second, np.eye(3) / 3, atol=1e-5)


@pytest.mark.parametrize("shape", [(3,), (0, 3), (2, 5, 3)])
def test_points_of_any_shape_are_projected(shape):
    pixels, depth = Camera(**FRAME).project(np.zeros(shape), WIDTH, HEIGHT)
    assert pixels.shape == (*shape[:-1], 2)
    assert depth.shape == shape[:-1]


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(
    "points", [[1, 2], [[1, 2, 3, 4]], [np.nan, 0, 0], [[0, 0, np.inf]], "abc", [[1, 2, 3], [1, 2]], 5]
)
def test_points_that_are_none_are_refused(name, points):
    with pytest.raises(SceneError, match="points that a camera projects"):
        CAMERAS[name].project(points, WIDTH, HEIGHT)


@pytest.mark.parametrize("pixels", [[1], [1, 2, 3], [np.nan, 0]])
def test_pixels_that_are_none_are_refused(pixels):
    with pytest.raises(SceneError, match="the pixels of rays"):
        Camera(**FRAME).rays_at(pixels, WIDTH, HEIGHT)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_cameras_of_any_size_project_the_same(projection, scale):
    if isinstance(projection, Orthographic):
        projection = Orthographic(4 * scale)
    frame = {name: np.multiply(value, scale) for name, value in FRAME.items()}
    points = np.random.default_rng(7).normal(size=(20, 3))
    expected = Camera(**FRAME, projection=Orthographic(4) if isinstance(projection, Orthographic) else projection)
    found = Camera(**frame, projection=projection).project(points * scale, WIDTH, HEIGHT)[0]
    np.testing.assert_allclose(found, expected.project(points, WIDTH, HEIGHT)[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("height", [0, -1, math.nan, math.inf, "2", True])
def test_a_height_that_is_none_is_refused(height):
    with pytest.raises(SceneError, match="height"):
        Orthographic(height)


@pytest.mark.parametrize("angle", [0, -1, 360.1, math.nan, None, "180"])
def test_an_angle_that_is_none_is_refused(angle):
    with pytest.raises(SceneError, match="angle"):
        Fisheye(angle)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"projection": "circle"}, "must be one of perspective, orthographic, fisheye, panorama"),
        ({"projection": Fisheye}, "must be a clbvh.Orthographic"),
        ({"projection": Orthographic()}, "needs a height"),
        ({"projection": Panorama(), "lens": Lens.from_fov(40, 64, 48)}, "the panorama one has none"),
        ({"projection": Fisheye(), "aperture": 0.1}, "no plane of focus"),
        ({"projection": Panorama(), "aperture": 0.1}, "no plane of focus"),
        ({"aperture": -0.1}, "aperture"),
        ({"aperture": math.nan}, "aperture"),
        ({"aperture": "wide"}, "aperture"),
        ({"aperture": 0.1, "focus_distance": 0}, "focus_distance"),
        ({"aperture": 0.1, "focus_distance": math.nan}, "focus_distance"),
        ({"aperture": 0.1, "focus_distance": math.inf}, "focus_distance"),
        ({"aperture": 0.1, "lens": Lens.from_fov(40, 64, 48)}, "needs a focus_distance"),
    ],
)
def test_values_that_do_not_go_together_are_refused(values, message):
    with pytest.raises(SceneError, match=message):
        Camera(**FRAME, **values)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_other_projections_have_no_intrinsic_matrix(projection):
    with pytest.raises(SceneError, match="that of a perspective camera"):
        Camera(**FRAME, projection=projection).intrinsics(64, 48)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_cameras_are_values_whatever_their_projection(projection):
    camera = Camera(**FRAME, projection=projection)
    assert pickle.loads(pickle.dumps(camera)) == camera
    assert hash(camera) == hash(Camera(**FRAME, projection=projection))
    assert camera != Camera(**FRAME)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_camera_orbits_with_its_projection(projection):
    camera = Camera(**FRAME, projection=projection)
    turned = camera.orbit(90)
    assert turned.projection == projection
    # The scene turned the other way shows the same.
    axis = np.asarray(camera.up) / np.linalg.norm(camera.up)
    points = np.random.default_rng(8).normal(size=(20, 3))
    arm = points - camera.look_at
    along = (arm @ axis)[:, None] * axis
    rotated = camera.look_at + along + np.cross(axis, arm)
    np.testing.assert_allclose(
        turned.project(rotated, WIDTH, HEIGHT)[0], camera.project(points, WIDTH, HEIGHT)[0], rtol=0, atol=1e-9
    )


def test_the_focus_is_the_point_looked_at_or_a_distance():
    assert Camera(**LOOKING_DOWN_Z, aperture=0.1).focus == 1
    assert Camera(**LOOKING_DOWN_Z, aperture=0.1, focus_distance=3).focus == 3
    assert clbvh.Camera(**LOOKING_DOWN_Z, aperture=np.float32(0.5), focus_distance=1e9).focus == 1e9


@pytest.mark.parametrize(
    "projection",
    [None, Orthographic(), Orthographic(0.1 + 0.2), Fisheye(1 / 3), Panorama()],
)
def test_a_text_gives_the_same_projection(projection):
    assert read_projection(text_of(projection)) == read_projection(projection) == projection
    assert text_of(projection).split(":")[0] in ("perspective", "orthographic", "fisheye", "panorama")


@pytest.mark.parametrize(
    ("text", "projection"),
    [("perspective", None), ("fisheye:220", Fisheye(220)), ("orthographic:2.5", Orthographic(2.5))],
)
def test_texts_of_projections(text, projection):
    assert read_projection(text) == projection


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("", "must be one of perspective, orthographic, fisheye, panorama, not ''"),
        ("Fisheye", "must be one of"),
        ("panorama:3", "panorama has no value"),
        ("perspective:", "perspective has no value"),
        ("fisheye:wide", "must be a number, as in fisheye:2, not 'wide'"),
        ("fisheye:", "must be a number"),
        ("fisheye:400", "above 0 and up to 360"),
        ("orthographic:nan", "above 0"),
        (220, "must be a clbvh.Orthographic, Fisheye or Panorama, or a text such as"),
    ],
)
def test_other_values_are_no_projection(value, message):
    with pytest.raises(SceneError, match=message):
        Camera(**FRAME, projection=value)

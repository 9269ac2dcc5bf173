"""Cameras of all projections: axes, rays by formula and the way back, turns, files, pictures, and what is refused."""

import json
import math

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import clbvh
from clbvh import Camera, Fisheye, Lens, Orthographic, Panorama, SceneError
from clbvh.rendering.images import read_camera

CAMERA = Camera((1.0, 2.0, 3.0), (0.0, 0.5, 0.0), up=(0, 2, 0), fov=40)
K = [[500.0, 1.0, 310.0], [0.0, 510.0, 250.0], [0.0, 0.0, 1.0]]
LENS_CAMERA = Camera.from_intrinsics(K, np.eye(4), (640, 480))
DOWN_Z = {"eye": (0, 0, 0), "look_at": (0, 0, -1)}
TOO_LONG = 10**400  # an integer that float64 cannot hold


def test_axes_are_orthonormal_and_right_handed_whatever_the_length_of_up():
    for length in (5e-324, 1e-310, 1.0, 1.7e308):
        right, up, forward = np.array(Camera((1, 2, 3), (4, -1, 0), up=(0, length, 0)).axes())
        assert_allclose([right @ up, right @ forward, up @ forward, right[1]], 0, atol=1e-15)
        assert_allclose([right @ right, up @ up, forward @ forward], 1)
        assert_allclose(np.cross(right, up), -forward, atol=1e-15)
        assert up[1] > 0


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


FRAME = {"eye": (2.5, 1.5, 3.0), "look_at": (0.1, 0, 0.2), "up": (0.1, 1.0, 0.2)}
LENS = [[90.0, 2.0, 44.0], [0, 85.0, 39.0], [0, 0, 1]]
POSE = Camera(**FRAME).camera_to_world()
WIDTH, HEIGHT = 96, 72

CAMERAS = {
    "perspective": Camera(**FRAME),
    "lens": Camera.from_intrinsics(LENS, POSE, (WIDTH, HEIGHT)),
    "distorted": Camera.from_intrinsics(LENS, POSE, (WIDTH, HEIGHT), distortion=(-0.28, 0.11, 0.003, -0.004, -0.02)),
    "orthographic": Camera(**FRAME, projection=Orthographic(2.2)),
    "fisheye": Camera(**FRAME, projection=Fisheye(60)),
    "fisheye-inside": Camera(eye=(0, 0, 0), look_at=(1, 0, 0), projection=Fisheye(360)),
    "panorama": Camera(eye=(0.6, 0.1, 0), look_at=(1, 0.2, 0), projection=Panorama()),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_point_on_a_ray_is_projected_to_where_the_ray_comes_from(name):
    camera = CAMERAS[name]
    pixels = np.random.default_rng(5).uniform(0, (WIDTH, HEIGHT), (300, 2))
    if name.startswith("fisheye"):
        pixels = pixels[np.hypot(*(pixels - [WIDTH / 2, HEIGHT / 2]).T) < 0.999 * HEIGHT / 2]
    origins, directions = camera.rays_at(pixels, WIDTH, HEIGHT)
    assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=0, atol=1e-15)
    points = origins + np.random.default_rng(6).uniform(0.1, 1000, (len(pixels), 1)) * directions
    found, depth = camera.project(points, WIDTH, HEIGHT)
    assert_allclose(found, pixels, rtol=0, atol=1e-8)
    assert_allclose(depth, (points - camera.eye) @ camera.axes()[2], rtol=0, atol=1e-10)
    # The rays of a picture are those through its pixel centres, and depth is t times the cosine.
    whole = camera.rays(WIDTH, HEIGHT)
    centres = np.stack(np.mgrid[:HEIGHT, :WIDTH][::-1], axis=-1) + 0.5
    for part, of_pictures in zip(camera.rays_at(centres, WIDTH, HEIGHT), whole, strict=True):
        assert_allclose(part, of_pictures, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(camera.rays(WIDTH, HEIGHT, range(3, 8))[0], whole[0][3:8])
    np.testing.assert_array_equal(camera.cosines(WIDTH, HEIGHT), whole[1] @ camera.axes()[2])


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


def test_a_fisheye_is_equidistant_in_the_circle_that_touches_the_shorter_sides():
    for angle in (1e-3, 180, 360):
        radius = np.linspace(0, 1, 9)
        pixels = np.stack((100 + 50 * radius, np.full(9, 50.0)), axis=1)
        x, y, z = Camera(**DOWN_Z, projection=Fisheye(angle)).rays_at(pixels, 200, 100)[1].T
        assert_allclose(np.arctan2(x, -z), np.radians(angle) / 2 * radius, rtol=1e-9, atol=1e-15)
        assert np.abs(y).max() < 1e-15
    for width, height in ((80, 60), (60, 80)):
        rows, columns = np.mgrid[:height, :width] + 0.5
        inside = np.hypot(columns - width / 2, rows - height / 2) <= 30
        np.testing.assert_array_equal(Camera(**FRAME, projection=Fisheye()).sees(width, height), inside)
    assert Camera(**FRAME).sees(3, 2).all()
    pixels, _ = Camera(**DOWN_Z, projection=Fisheye()).project([[0, 0, 1], [1, 0, 0.1], [0, 0, 0], [1, 0, 0]], 100, 100)
    assert np.isnan(pixels[:3]).all()
    assert pixels[3] == pytest.approx([100, 50])


@pytest.mark.parametrize("name", CAMERAS)
def test_a_picture_has_the_hits_of_the_rays(mesh, world, name):
    camera = CAMERAS[name]
    for source in (mesh, world):
        view = clbvh.View(width=WIDTH, height=HEIGHT, shading="lambert+shadow", up="y")
        with clbvh.Renderer(source, view, clbvh.RenderOptions(validate=True)) as renderer:
            picture, depth = renderer.render(camera=camera), renderer.render(camera=camera, shading="depth")
        assert picture.validated_pixels > 0
        is_hit, is_seen = picture.hits.is_hit, camera.sees(WIDTH, HEIGHT)
        assert is_hit.mean() > 0.02
        assert not is_hit[~is_seen].any()
        assert (picture.rgb[~is_seen] == 0).all()
        assert (picture.rgb[is_seen].max(axis=1) > 0).all()
        # Hits are projected back to the centres of their pixels.
        pixels, expected = camera.project(picture.hits.locations[is_hit], WIDTH, HEIGHT)
        rows, columns = np.nonzero(is_hit)
        assert_allclose(pixels, np.stack((columns, rows), axis=1) + 0.5, rtol=0, atol=1e-7)
        assert_allclose(picture.depth[is_hit], expected, rtol=0, atol=1e-9)
        # A depth picture of all directions shows distances.
        is_wide = isinstance(camera.projection, Fisheye | Panorama)
        order = np.argsort((picture.hits.t if is_wide else picture.depth)[is_hit])
        grey = depth.rgb[is_hit][order, 0].astype(int)
        assert (np.diff(grey) <= 1).all()
        assert np.ptp(grey) > 20


def test_what_is_no_camera_and_no_turn_is_refused():
    place, lens = {"eye": (0, 0, 1), "look_at": (0, 0, 0)}, LENS_CAMERA.lens
    rows = [
        (lambda: Camera(**place, fov=TOO_LONG), "fov must be"), (lambda: CAMERA.orbit(math.nan), "finite number"),
        (lambda: Camera((1, 1, 1), (1, 1, 1)), "same point"), (lambda: Camera((0, 1, 0), (0, 0, 0)), "parallel"),
        (lambda: Camera(**place, up=(0, 0, 0)), "up is zero"), (lambda: Camera((0, 0, math.inf), (0, 0, 0)), "finite"),
        (lambda: Camera((1e308, 0, 0), (-1e308, 0, 0)), "farther apart"),
        (lambda: Camera(**place, fov=60, lens=lens), "follows from its lens"),
        (lambda: Camera(**place).rays(), "has no size"), (lambda: CAMERA.rays(8, 6, range(4, 7)), "the rows of"),
        (lambda: Camera(**place, aperture=0.1, lens=lens), "needs a focus_distance"),
        (lambda: Lens(TOO_LONG, 1, 0, 0, 0, 640, 480), "fx must be a finite number"),
        (lambda: CAMERA.orbit(90, axis=(0, 0, 0)), "must not be zero"), (lambda: LENS_CAMERA.orbit(25), "as `about`"),
        (lambda: CAMERA.project([np.nan, 0, 0], 9, 9), "points that"),
        (lambda: CAMERA.rays_at([1, 2, 3], 9, 9), "the pixels of rays"),
        (lambda: Camera(**place, projection=Orthographic()), "needs a height"),
        (lambda: Camera(**place, projection=Panorama(), lens=lens), "the panorama one has none"),
        (lambda: CAMERAS["panorama"].intrinsics(64, 48), "that of a perspective camera"),
    ]  # fmt: skip
    for call, words in rows:
        with pytest.raises(SceneError, match=words):
            call()


# Lenses: matrices and poses by formula, and the distortion of OpenCV.
SIZE = (64, 48)
MATRIX = np.array([[51.0, 2.5, 20.25], [0.0, 60.0, 30.5], [0.0, 0.0, 1.0]])
TIGHT = {"rtol": 0, "atol": 1e-14}

# From the axes of a camera to those of OpenCV: x right, y down, z forward.
TO_OPENCV = {"opencv": np.eye(3), "opengl": np.diag([1.0, -1.0, -1.0])}
CENTRE = {"half": 0.5, "integer": 0.0}
LENSES = [
    (-0.3, 0.09, 0.0, 0.0, 0.0), (0.4, 0.2, 0.0, 0.0, 0.1), (0.0, 0.0, 0.02, -0.015, 0.0),
    (-0.2, 0.4, 0.0, 0.001, -0.1), (-0.28, 0.11, 0.003, -0.004, -0.02),
]  # fmt: skip


def make_pose(seed: int, distance: float = 10.0) -> np.ndarray:
    """A random rotation and eye."""
    generator = np.random.default_rng([91, seed])
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = generator.normal(size=3) * distance
    return pose


TURNED = make_pose(0)


def expected_directions(pose, convention="opencv", pixel_centres="half"):
    """Pixels through the inverse matrix, in float64."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + CENTRE[pixel_centres]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    directions = pixels @ np.linalg.inv(MATRIX).T @ TO_OPENCV[convention].T @ pose[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@pytest.mark.parametrize("pixel_centres", CENTRE)
@pytest.mark.parametrize("convention", TO_OPENCV)
def test_rays_are_those_of_the_formula_and_matrix_and_pose_come_back(convention, pixel_centres):
    # A far eye does not turn the camera.
    for pose in (TURNED, make_pose(5, 1e-30), make_pose(6, 1e30)):
        camera = Camera.from_intrinsics(MATRIX, pose, SIZE, convention, pixel_centres=pixel_centres)
        origins, directions = camera.rays()
        assert_allclose(directions, expected_directions(pose, convention, pixel_centres), **TIGHT)
        assert (origins == pose[:3, 3]).all()
        assert_allclose(camera.intrinsics(pixel_centres=pixel_centres), MATRIX, rtol=1e-15)
        assert_allclose(camera.camera_to_world(convention)[:3, :3], pose[:3, :3], **TIGHT)
    rounded = Camera.from_intrinsics(MATRIX, TURNED.round(5), SIZE)
    assert_allclose(np.linalg.norm(rounded.axes(), axis=1), 1, rtol=1e-15)


def test_a_picture_of_another_size_and_the_same_aspect_ratio_shows_the_same():
    distorted = Camera.from_intrinsics(MATRIX, TURNED, SIZE, distortion=LENSES[-1])
    whole, half = distorted.rays_at([[10, 20], [60, 40]])[1], distorted.rays_at([[5, 10], [30, 20]], 32, 24)[1]
    assert_allclose(half, whole, **TIGHT)
    camera = Camera.from_intrinsics(MATRIX, TURNED, SIZE)
    for width, height in ((128, 96), (32, 24)):
        resized = Camera.from_intrinsics(np.diag([width / 64, width / 64, 1]) @ MATRIX, TURNED, (width, height))
        assert_allclose(camera.rays(width, height)[1], resized.rays()[1], **TIGHT)
        assert (camera.rays(width=width)[1] == camera.rays(height=height)[1]).all()
    odd = Camera.from_intrinsics([[700, 0, 610], [0, 700, 170], [0, 0, 1]], np.eye(4), (1241, 376))
    assert odd.rays(620, 188)[1].shape == (188, 620, 3)
    with pytest.raises(SceneError, match="64 x 48, and 64 x 40 has another aspect ratio"):
        camera.rays(64, 40)


def changed(row, column, value, matrix=MATRIX):
    other = np.array(matrix, dtype=float)
    other[row, column] = value
    return other


def test_matrices_poses_and_sizes_of_no_camera_are_refused():
    form, rigid, eye = r"must be \[\[fx, skew, cx\]", "rigid", np.eye(4)
    matrices = [
        (changed(0, 0, 0), "fx must be above 0"), (changed(1, 0, 1e-9), form), (changed(2, 2, 2), form),
        (changed(0, 0, np.nan), "finite"), (changed(0, 0, 1e-30), "no focal length"), (changed(0, 2, 1e30), "too far"),
        (changed(0, 1, 1e30), "too far"), (eye, "3 x 3 numbers"), ([[1, 2], [3]], "3 x 3 numbers"),
    ]  # fmt: skip
    poses = [
        (2 * eye, "last row"), (np.diag([1e200, 1, 1, 1]), rigid), (changed(0, 1, 0.5, eye), rigid),
        (np.diag([1, 1, 1.01, 1]), rigid), (np.diag([1.0, 1, -1, 1]), "mirrors"), (changed(0, 3, 1e308, eye), "finite"),
    ]  # fmt: skip
    rows = [((matrix, TURNED, SIZE), words) for matrix, words in matrices]
    rows += [((MATRIX, pose, SIZE), words) for pose, words in poses]
    rows += [((MATRIX, TURNED, size), "camera's") for size in ((0, 48), (64.0, 48), 64)]
    for arguments, words in [*rows, ((MATRIX, TURNED, SIZE, "blender"), "must be one of")]:
        with pytest.raises(SceneError, match=words):
            pytest.fail(str(Camera.from_intrinsics(*arguments)))


WIDE = np.array([[60.0, 2.0, 29.0], [0, 57.0, 26.0], [0, 0, 1]])


@pytest.mark.parametrize("distortion", LENSES)
def test_distortion_is_that_of_opencv_both_ways(distortion):
    camera = Camera.from_intrinsics(WIDE, TURNED, SIZE, distortion=distortion)
    inside = np.random.default_rng(2).uniform(0, SIZE, (500, 2))
    origins, directions = camera.rays_at(inside)
    points = origins + directions * 7
    # `cv2.projectPoints`, by the formula in OpenCV's documentation of calib3d.
    x, y, z = ((points - TURNED[:3, 3]) @ TURNED[:3, :3]).T
    x, y, (k1, k2, p1, p2, k3) = x / z, y / z, distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    shown_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    shown_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    expected = (np.stack((shown_x, shown_y, np.ones_like(x)), axis=-1) @ WIDE.T)[:, :2]
    pixels, depths = camera.project(points)
    assert_allclose(pixels, expected, rtol=0, atol=1e-9)
    assert_allclose(pixels, inside, rtol=0, atol=1e-8)
    assert_allclose(depths, z, rtol=1e-12)
    assert camera.lens.resized(128, 96).distortion == distortion


def test_a_distortion_that_folds_inside_the_picture_is_refused():
    for folds in ((-1.5, 0, 0, 0), (0, 0, 0.9, 0), (0.5, -3.0, 0, 0, 0), (1e30, 0, 0, -1e30), (-1e300, 0, 0, 0)):
        with pytest.raises(SceneError, match="no inverse in all of its picture"):
            Camera.from_intrinsics(WIDE, TURNED, SIZE, distortion=folds)
    # f(r) = r - r^3 / 2 has its fold at r = sqrt(2 / 3), where it is 0.544: outside of one picture, inside the other.
    row = {"fx": 100, "fy": 100, "cy": 0.5, "skew": 0, "height": 1, "distortion": (-0.5, 0, 0, 0)}
    Lens(cx=50, width=100, **row)
    with pytest.raises(SceneError, match="no inverse"):
        Lens(cx=55, width=110, **row)


def test_points_beyond_the_fold_are_not_seen():
    k = [[100, 0, 30], [0, 100, 30], [0, 0, 1]]
    camera = Camera.from_intrinsics(k, np.eye(4), (60, 60), distortion=(-0.5, 0, 0, 0))
    pixels, depth = camera.project([[0.5, 0, 1], [1.2, 0, 1], [0.5, 0, -1]])
    assert pixels[0] == pytest.approx([30 + 100 * (0.5 - 0.5 * 0.125), 30])
    # By the formula alone the second one would be at 30 + 33.6.
    assert np.isnan(pixels[1:]).all()
    assert depth.tolist() == [1, 1, -1]

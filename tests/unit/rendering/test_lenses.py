"""Lenses: cameras of an intrinsic matrix and a pose, by formula, and OpenCV's distortion."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from clbvh import Camera, Lens, SceneError

SIZE = (64, 48)
K = np.array([[51.0, 2.5, 20.25], [0.0, 60.0, 30.5], [0.0, 0.0, 1.0]])
TIGHT = {"rtol": 0, "atol": 1e-14}

# From the axes of a camera to those of OpenCV: x right, y down, z forward.
TO_OPENCV = {"opencv": np.eye(3), "opengl": np.diag([1.0, -1.0, -1.0])}
CENTRE = {"half": 0.5, "integer": 0.0}
LENSES = {
    "barrel": (-0.3, 0.09, 0.0, 0.0, 0.0),
    "pincushion": (0.4, 0.2, 0.0, 0.0, 0.1),
    "tangential": (0.0, 0.0, 0.02, -0.015, 0.0),
    "all": (-0.28, 0.11, 0.003, -0.004, -0.02),
    "moustache": (-0.2, 0.4, 0.0, 0.001, -0.1),
}


def make_pose(seed: int, distance: float = 10.0) -> np.ndarray:
    """A random rotation and eye."""
    generator = np.random.default_rng([91, seed])
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = generator.normal(size=3) * distance
    return pose


POSE = make_pose(0)


def expected_directions(pose, convention="opencv", pixel_centres="half"):
    """Pixels through the inverse matrix, in float64."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + CENTRE[pixel_centres]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    directions = pixels @ np.linalg.inv(K).T @ TO_OPENCV[convention].T @ pose[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@pytest.mark.parametrize("pixel_centres", CENTRE)
@pytest.mark.parametrize("convention", TO_OPENCV)
def test_rays_are_those_of_the_formula_and_matrix_and_pose_come_back(convention, pixel_centres):
    camera = Camera.from_intrinsics(K, POSE, SIZE, convention, pixel_centres=pixel_centres)
    origins, directions = camera.rays()
    assert_allclose(directions, expected_directions(POSE, convention, pixel_centres), **TIGHT)
    assert (origins == POSE[:3, 3]).all()
    assert_allclose(camera.intrinsics(pixel_centres=pixel_centres), K, rtol=1e-15)
    assert_allclose(camera.camera_to_world(convention), POSE, **TIGHT)


def test_a_far_eye_does_not_turn_the_camera():
    for distance in (1e-30, 1e6, 1e30):
        pose = make_pose(5, distance)
        assert_allclose(Camera.from_intrinsics(K, pose, SIZE).rays()[1], expected_directions(pose), **TIGHT)


def test_rays_are_those_of_trimesh():
    scene = trimesh.Scene(trimesh.creation.box())
    scene.camera = trimesh.scene.cameras.Camera(resolution=SIZE, fov=(60, 45))
    scene.camera_transform = POSE
    origins, directions, pixels = scene.camera_rays()
    ours = Camera.from_intrinsics(scene.camera.K, scene.camera_transform, SIZE, "opengl").rays()
    column, row = pixels[:, 0], SIZE[1] - 1 - pixels[:, 1]  # trimesh counts rows from the bottom
    assert_allclose(ours[0][row, column], origins, **TIGHT)
    assert_allclose(ours[1][row, column], directions, **TIGHT)


def test_a_camera_with_a_field_of_view_has_a_matrix_and_a_pose():
    camera = Camera((3, 2, 5), (0.5, -1, 0), up=(0.2, 1, 0), fov=50)
    again = Camera.from_intrinsics(camera.intrinsics(*SIZE), camera.camera_to_world("opengl"), SIZE, "opengl")
    assert_allclose(again.rays()[1], camera.rays(*SIZE)[1], **TIGHT)
    assert again.fov == pytest.approx(50, abs=1e-12)


def test_a_picture_of_another_size_and_the_same_aspect_ratio_shows_the_same():
    distorted = Camera.from_intrinsics(K, POSE, SIZE, distortion=LENSES["all"])
    whole, half = distorted.rays_at([[10, 20], [60, 40]])[1], distorted.rays_at([[5, 10], [30, 20]], 32, 24)[1]
    assert_allclose(half, whole, **TIGHT)
    camera = Camera.from_intrinsics(K, POSE, SIZE)
    for width, height in ((128, 96), (32, 24)):
        resized = Camera.from_intrinsics(np.diag([width / 64, width / 64, 1]) @ K, POSE, (width, height))
        assert_allclose(camera.rays(width, height)[1], resized.rays()[1], **TIGHT)
        assert (camera.rays(width=width)[1] == camera.rays(height=height)[1]).all()
    odd = Camera.from_intrinsics([[700, 0, 610], [0, 700, 170], [0, 0, 1]], np.eye(4), (1241, 376))
    assert odd.rays(620, 188)[1].shape == (188, 620, 3)
    for size in ((64, 64), (800, 450), (64, 40)):
        with pytest.raises(SceneError, match=rf"64 x 48, and {size[0]} x {size[1]} has another aspect ratio"):
            camera.rays(*size)


def test_a_pose_of_rounded_numbers_is_corrected():
    rounded = Camera.from_intrinsics(K, POSE.round(5), SIZE)
    assert_allclose(np.linalg.norm(rounded.axes(), axis=1), 1, rtol=1e-15)
    assert_allclose(rounded.camera_to_world()[:3, :3], POSE[:3, :3], rtol=0, atol=2e-5)


def changed(row, column, value, matrix=K):
    other = np.array(matrix, dtype=float)
    other[row, column] = value
    return other


def test_matrices_poses_and_sizes_of_no_camera_are_refused():
    form, rigid = r"must be \[\[fx, skew, cx\]", "rigid"
    matrices = [
        (changed(0, 0, 0), "fx must be above 0, not 0"), (changed(1, 1, -60), "fy must be above 0, not -60"),
        (changed(0, 0, np.nan), "must be finite"), (changed(1, 0, 1e-9), form), (changed(2, 2, 2), form),
        (changed(2, 0, 1), form), (changed(0, 0, 1e-30), "no focal length"), (changed(1, 1, 1e30), "no focal length"),
        (changed(0, 2, 1e30), "too far"), (changed(0, 1, 1e30), "too far"), (K.T, form),
        (np.eye(4), r"3 x 3 numbers, not float64 of shape \(4, 4\)"), (None, "3 x 3 numbers, not None"),
        ([[1, 2], [3]], "3 x 3 numbers, not rows of different lengths"), (K.astype(complex), "not complex128"),
    ]  # fmt: skip
    poses = [
        (2 * np.eye(4), "last row"), (POSE.T, "last row"), (np.diag([2.0, 2, 2, 1]), rigid),
        (np.diag([1.0, 1, 1.01, 1]), rigid), (np.diag([0.0, 0, 0, 1]), rigid), (np.diag([1e200, 1, 1, 1]), rigid),
        (changed(0, 1, 0.5, np.eye(4)), rigid), (np.diag([1.0, 1, -1, 1]), "mirrors"),
        (changed(0, 3, np.nan, np.eye(4)), "finite"), (changed(0, 3, 1e308, np.eye(4)), "finite"),
        (np.eye(3), "4 x 4 numbers"),
    ]  # fmt: skip
    sizes = [(size, "camera's") for size in ((0, 48), (64, -1), (64.0, 48), (True, 48), 64, (64, 48, 3), None)]
    rows = [((k, POSE, SIZE), words) for k, words in matrices] + [((K, pose, SIZE), words) for pose, words in poses]
    rows += [((K, POSE, size), words) for size, words in sizes] + [((K, POSE, SIZE, "blender"), "must be one of")]
    for arguments, words in rows:
        with pytest.raises(SceneError, match=words):
            pytest.fail(str(Camera.from_intrinsics(*arguments)))
    with pytest.raises(SceneError, match="must be one of"):
        Camera.from_intrinsics(K, POSE, SIZE, pixel_centres="corner")


def project_as_opencv(points, world_to_camera, distortion):
    """`cv2.projectPoints`, by the formula in OpenCV's documentation of calib3d: pixels, and the depths."""
    x, y, z = (points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).T
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    shown_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    shown_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    homogeneous = np.stack((shown_x, shown_y, np.ones_like(x)), axis=-1) @ WIDE.T
    return homogeneous[:, :2], z


WIDE = np.array([[60.0, 2.0, 29.0], [0, 57.0, 26.0], [0, 0, 1]])


@pytest.mark.parametrize("name", LENSES)
def test_distortion_is_that_of_opencv_both_ways(name):
    camera = Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=LENSES[name])
    inside = np.random.default_rng(2).uniform(0, SIZE, (500, 2))
    origins, directions = camera.rays_at(inside)
    points = origins + directions * 7
    expected, depth = project_as_opencv(points, np.linalg.inv(POSE), LENSES[name])
    pixels, depths = camera.project(points)
    assert_allclose(pixels, expected, rtol=0, atol=1e-9)
    assert_allclose(pixels, inside, rtol=0, atol=1e-8)
    assert_allclose(depths, depth, rtol=1e-12)
    assert camera.lens.resized(128, 96).distortion == LENSES[name]


def test_coefficients_come_in_the_shapes_of_opencv_and_others_are_refused():
    plain = Camera.from_intrinsics(WIDE, POSE, SIZE)
    assert Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=np.zeros((1, 5))) == plain
    values = (-0.28, 0.11, 0.003, -0.004, 0.0)
    for shape in ((5,), (1, 5), (5, 1), (4,), (1, 4)):
        camera = Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=np.reshape(values[: max(shape)], shape))
        assert camera.lens.distortion == values
    for wrong in ((0.1,), (0.1, 0, 0), np.zeros(8) + 0.1, (np.nan, 0, 0, 0), "abcd"):
        with pytest.raises(SceneError, match="k1, k2, p1, p2"):
            Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=wrong)


def test_a_distortion_that_folds_inside_the_picture_is_refused():
    for folds in ((-1.5, 0, 0, 0), (0, 0, 0.9, 0), (0.5, -3.0, 0, 0, 0), (1e30, 0, 0, -1e30), (-1e300, 0, 0, 0)):
        with pytest.raises(SceneError, match="no inverse in all of its picture"):
            Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=folds)
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


def test_what_is_accepted_is_inverted_all_over_the_picture():
    accepted = 0
    for seed in range(20):
        distortion = np.random.default_rng([3, seed]).normal(size=5) * [0.4, 0.4, 0.05, 0.05, 0.4]
        try:
            camera = Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=distortion)
        except SceneError:
            continue
        accepted += 1
        points = np.random.default_rng(seed).uniform(0, SIZE, (2000, 2))
        origins, directions = camera.rays_at(points)
        assert_allclose(camera.project(origins + 3 * directions)[0], points, rtol=0, atol=1e-6)
    assert accepted > 5

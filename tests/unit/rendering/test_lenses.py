"""Lenses: cameras of an intrinsic matrix and a pose, by formula, and OpenCV's distortion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from clbvh import Camera, Lens, SceneError

SIZE = (64, 48)
K = np.array([[51.0, 2.5, 20.25], [0.0, 60.0, 30.5], [0.0, 0.0, 1.0]])
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
    # A far eye does not turn the camera.
    for pose in (POSE, make_pose(5, 1e-30), make_pose(6, 1e30)):
        camera = Camera.from_intrinsics(K, pose, SIZE, convention, pixel_centres=pixel_centres)
        origins, directions = camera.rays()
        assert_allclose(directions, expected_directions(pose, convention, pixel_centres), **TIGHT)
        assert (origins == pose[:3, 3]).all()
        assert_allclose(camera.intrinsics(pixel_centres=pixel_centres), K, rtol=1e-15)
        assert_allclose(camera.camera_to_world(convention)[:3, :3], pose[:3, :3], **TIGHT)
    rounded = Camera.from_intrinsics(K, POSE.round(5), SIZE)
    assert_allclose(np.linalg.norm(rounded.axes(), axis=1), 1, rtol=1e-15)


def test_a_picture_of_another_size_and_the_same_aspect_ratio_shows_the_same():
    distorted = Camera.from_intrinsics(K, POSE, SIZE, distortion=LENSES[-1])
    whole, half = distorted.rays_at([[10, 20], [60, 40]])[1], distorted.rays_at([[5, 10], [30, 20]], 32, 24)[1]
    assert_allclose(half, whole, **TIGHT)
    camera = Camera.from_intrinsics(K, POSE, SIZE)
    for width, height in ((128, 96), (32, 24)):
        resized = Camera.from_intrinsics(np.diag([width / 64, width / 64, 1]) @ K, POSE, (width, height))
        assert_allclose(camera.rays(width, height)[1], resized.rays()[1], **TIGHT)
        assert (camera.rays(width=width)[1] == camera.rays(height=height)[1]).all()
    odd = Camera.from_intrinsics([[700, 0, 610], [0, 700, 170], [0, 0, 1]], np.eye(4), (1241, 376))
    assert odd.rays(620, 188)[1].shape == (188, 620, 3)
    with pytest.raises(SceneError, match="64 x 48, and 64 x 40 has another aspect ratio"):
        camera.rays(64, 40)


def changed(row, column, value, matrix=K):
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
    rows = [((k, POSE, SIZE), words) for k, words in matrices] + [((K, pose, SIZE), words) for pose, words in poses]
    rows += [((K, POSE, size), "camera's") for size in ((0, 48), (64.0, 48), 64)]
    for arguments, words in [*rows, ((K, POSE, SIZE, "blender"), "must be one of")]:
        with pytest.raises(SceneError, match=words):
            pytest.fail(str(Camera.from_intrinsics(*arguments)))


WIDE = np.array([[60.0, 2.0, 29.0], [0, 57.0, 26.0], [0, 0, 1]])


@pytest.mark.parametrize("distortion", LENSES)
def test_distortion_is_that_of_opencv_both_ways(distortion):
    camera = Camera.from_intrinsics(WIDE, POSE, SIZE, distortion=distortion)
    inside = np.random.default_rng(2).uniform(0, SIZE, (500, 2))
    origins, directions = camera.rays_at(inside)
    points = origins + directions * 7
    # `cv2.projectPoints`, by the formula in OpenCV's documentation of calib3d.
    x, y, z = ((points - POSE[:3, 3]) @ POSE[:3, :3]).T
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

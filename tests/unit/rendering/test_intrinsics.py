"""Cameras from an intrinsic matrix and a pose: their rays by formula, their inverse, and what is no camera."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from clbvh import Camera, Lens
from clbvh.errors import SceneError

SIZE = (64, 48)
K = np.array([[51.0, 2.5, 20.25], [0.0, 60.0, 30.5], [0.0, 0.0, 1.0]])
TIGHT = {"rtol": 0, "atol": 1e-14}

# From the axes of a camera to those of OpenCV: x right, y down, z forward.
TO_OPENCV = {"opencv": np.eye(3), "opengl": np.diag([1.0, -1.0, -1.0])}
CENTRE = {"half": 0.5, "integer": 0.0}


def make_pose(seed: int, distance: float = 10.0) -> np.ndarray:
    """A random rotation and eye."""
    generator = np.random.default_rng([91, seed])
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = generator.normal(size=3) * distance
    return pose


def expected_directions(k, pose, size, convention, pixel_centres):
    """Pixels through the inverse matrix, in float64."""
    rows, columns = np.mgrid[: size[1], : size[0]] + CENTRE[pixel_centres]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    directions = pixels @ np.linalg.inv(k).T @ TO_OPENCV[convention].T @ pose[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@pytest.mark.parametrize("pixel_centres", ["half", "integer"])
@pytest.mark.parametrize("convention", ["opencv", "opengl"])
@pytest.mark.parametrize("seed", range(3))
def test_rays_are_those_of_the_formula(seed, convention, pixel_centres):
    pose = make_pose(seed)
    camera = Camera.from_intrinsics(K, pose, SIZE, convention, pixel_centres=pixel_centres)
    origins, directions = camera.rays()
    assert_allclose(directions, expected_directions(K, pose, SIZE, convention, pixel_centres), **TIGHT)
    assert (origins == pose[:3, 3]).all()
    assert origins.shape == directions.shape == (48, 64, 3)


@pytest.mark.parametrize("distance", [1e-30, 1e-3, 1e6, 1e30])
def test_a_far_eye_does_not_turn_the_camera(distance):
    pose = make_pose(5, distance)
    directions = Camera.from_intrinsics(K, pose, SIZE).rays()[1]
    assert_allclose(directions, expected_directions(K, pose, SIZE, "opencv", "half"), **TIGHT)


def test_without_skew_rows_are_rows_and_the_principal_point_looks_ahead():
    k = [[50, 0, 10.5], [0, 40, 30.5], [0, 0, 1]]
    directions = Camera.from_intrinsics(k, np.eye(4), SIZE).rays()[1]
    assert_allclose(directions[30, 10], [0, 0, 1], **TIGHT)
    slopes = directions / directions[..., 2:]
    assert_allclose(slopes[..., 1], np.broadcast_to(slopes[:, :1, 1], (48, 64)), **TIGHT)
    assert slopes[31, 0, 1] - slopes[30, 0, 1] == pytest.approx(1 / 40)
    assert slopes[0, 11, 0] - slopes[0, 10, 0] == pytest.approx(1 / 50)


def test_the_two_pixel_centres_are_half_a_pixel_apart():
    moved = K.copy()
    moved[:2, 2] += 0.5
    integer = Camera.from_intrinsics(K, np.eye(4), SIZE, pixel_centres="integer")
    assert integer == Camera.from_intrinsics(moved, np.eye(4), SIZE)
    assert integer != Camera.from_intrinsics(K, np.eye(4), SIZE)


def test_rays_are_those_of_trimesh():
    scene = trimesh.Scene(trimesh.creation.box())
    scene.camera = trimesh.scene.cameras.Camera(resolution=SIZE, fov=(60, 45))
    scene.camera_transform = make_pose(1)
    origins, directions, pixels = scene.camera_rays()
    ours = Camera.from_intrinsics(scene.camera.K, scene.camera_transform, SIZE, "opengl").rays()
    column, row = pixels[:, 0], SIZE[1] - 1 - pixels[:, 1]  # trimesh counts rows from the bottom
    assert_allclose(ours[0][row, column], origins, **TIGHT)
    assert_allclose(ours[1][row, column], directions, **TIGHT)


@pytest.mark.parametrize("convention", ["opencv", "opengl"])
@pytest.mark.parametrize("pixel_centres", ["half", "integer"])
def test_matrix_and_pose_come_back(convention, pixel_centres):
    pose = make_pose(2)
    camera = Camera.from_intrinsics(K, pose, SIZE, convention, pixel_centres=pixel_centres)
    assert_allclose(camera.intrinsics(pixel_centres=pixel_centres), K, rtol=1e-15)
    assert_allclose(camera.camera_to_world(convention), pose, rtol=0, atol=1e-14)


def test_a_camera_with_a_field_of_view_has_a_matrix_and_a_pose():
    camera = Camera((3, 2, 5), (0.5, -1, 0), up=(0.2, 1, 0), fov=50)
    again = Camera.from_intrinsics(camera.intrinsics(*SIZE), camera.camera_to_world("opengl"), SIZE, "opengl")
    assert_allclose(again.rays()[1], camera.rays(*SIZE)[1], **TIGHT)
    assert again.fov == pytest.approx(50, abs=1e-12)


@pytest.mark.parametrize("scale", [2, 0.5])
def test_a_picture_of_another_size_and_the_same_aspect_ratio_shows_the_same(scale):
    camera = Camera.from_intrinsics(K, make_pose(3), SIZE)
    size = int(SIZE[0] * scale), int(SIZE[1] * scale)
    resized = Camera.from_intrinsics(np.diag([scale, scale, 1]) @ K, make_pose(3), size)
    assert_allclose(camera.rays(*size)[1], resized.rays()[1], **TIGHT)
    # Half of the other side is as good as both.
    assert (camera.rays(width=size[0])[1] == camera.rays(*size)[1]).all()
    assert (camera.rays(height=size[1])[1] == camera.rays(*size)[1]).all()


def test_half_of_an_odd_size_has_its_aspect_ratio():
    camera = Camera.from_intrinsics([[700, 0, 610], [0, 700, 170], [0, 0, 1]], np.eye(4), (1241, 376))
    assert camera.rays(620, 188)[1].shape == (188, 620, 3)


@pytest.mark.parametrize("size", [(64, 64), (48, 64), (800, 450), (64, 40)])
def test_another_aspect_ratio_is_refused(size):
    with pytest.raises(SceneError, match=rf"64 x 48, and {size[0]} x {size[1]} has another aspect ratio"):
        Camera.from_intrinsics(K, np.eye(4), SIZE).rays(*size)


def test_rows_are_those_of_the_whole():
    camera = Camera.from_intrinsics(K, make_pose(4), SIZE)
    assert (camera.rays(*SIZE, range(5, 9))[1] == camera.rays()[1][5:9]).all()


def test_depth_is_t_times_the_cosine():
    camera = Camera.from_intrinsics(K, make_pose(4), SIZE)
    cosines = camera.cosines()
    # A plane at depth 3, in the camera's axes.
    forward = make_pose(4)[:3, 2]
    t = 3 / (camera.rays()[1] @ forward)
    assert_allclose(t * cosines, 3, rtol=1e-14)
    assert (cosines > 0).all()


def test_origins_are_one_point_that_is_not_copied():
    origins, _ = Camera.from_intrinsics(K, np.eye(4), SIZE).rays()
    assert origins.strides[:2] == (0, 0)
    assert not origins.flags.writeable


def test_a_pose_of_rounded_numbers_is_corrected():
    pose = make_pose(6)
    rounded = Camera.from_intrinsics(K, pose.round(5), SIZE)
    assert_allclose(np.linalg.norm(rounded.axes(), axis=1), 1, rtol=1e-15)
    assert_allclose(rounded.camera_to_world()[:3, :3], pose[:3, :3], rtol=0, atol=2e-5)
    assert Camera.from_intrinsics(K, pose.astype(np.float32), SIZE).eye == tuple(pose[:3, 3].astype(np.float32))


def test_a_camera_is_a_value():
    camera = Camera.from_intrinsics(K, make_pose(1), SIZE)
    assert camera == Camera.from_intrinsics(K.tolist(), make_pose(1).tolist(), list(SIZE))
    assert pickle.loads(pickle.dumps(camera)) == copy.deepcopy(camera) == camera
    assert len({camera, Camera.from_intrinsics(K, make_pose(1), SIZE)}) == 1
    assert Camera(np.array([0.0, 0, 5]), [0, 0, 0]) == Camera((0, 0, 5), (0, 0, 0))


def test_changing_the_given_arrays_changes_no_camera():
    k, pose = K.copy(), make_pose(1)
    camera = Camera.from_intrinsics(k, pose, SIZE)
    before = camera.rays()[1].copy()
    k[:], pose[:] = 7, 7
    assert (camera.rays()[1] == before).all()


def changed(row, column, value, matrix=K):
    other = np.array(matrix, dtype=float)
    other[row, column] = value
    return other


@pytest.mark.parametrize(
    ("k", "message"),
    [
        (changed(0, 0, 0), r"fx must be above 0, not 0"),
        (changed(1, 1, -60), r"fy must be above 0, not -60"),
        (changed(0, 0, np.nan), r"must be finite"),
        (changed(0, 2, np.inf), r"must be finite"),
        (changed(1, 0, 1e-9), r"must be \[\[fx, skew, cx\]"),
        (changed(2, 2, 2), r"must be \[\[fx, skew, cx\]"),
        (changed(2, 0, 1), r"must be \[\[fx, skew, cx\]"),
        (changed(0, 0, 1e-30), r"no focal length"),
        (changed(1, 1, 1e30), r"no focal length"),
        (changed(0, 2, 1e30), r"too far"),
        (changed(0, 1, 1e30), r"too far"),
        (np.zeros((3, 3)), r"must be \[\[fx"),
        (np.eye(4), r"3 x 3 numbers, not float64 of shape \(4, 4\)"),
        (None, r"3 x 3 numbers, not None"),
        ("K", r"3 x 3 numbers, not 'K'"),
        ([[1, 2], [3]], r"3 x 3 numbers, not rows of different lengths"),
        (K.astype(complex), r"3 x 3 numbers, not complex128"),
        (K.T, r"must be \[\[fx"),
    ],
)
def test_a_matrix_that_is_no_lens_is_refused(k, message):
    with pytest.raises(SceneError, match=message):
        Camera.from_intrinsics(k, np.eye(4), SIZE)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (2 * np.eye(4), r"last row"),
        (np.diag([2.0, 2, 2, 1]), r"rigid"),
        (np.diag([1.0, 1, 1.01, 1]), r"rigid"),
        (np.zeros((4, 4)), r"last row"),
        (np.diag([0.0, 0, 0, 1]), r"rigid"),
        (np.diag([1e200, 1, 1, 1]), r"rigid"),
        (changed(0, 1, 0.5, np.eye(4)), r"rigid"),
        (np.diag([1.0, 1, -1, 1]), r"mirrors"),
        (np.diag([-1.0, -1, -1, 1]), r"mirrors"),
        (changed(0, 3, np.nan, np.eye(4)), r"finite"),
        (make_pose(0).T, r"last row"),
        (np.eye(3), r"4 x 4 numbers"),
        (np.eye(4)[:3], r"4 x 4 numbers"),
        (changed(0, 3, 1e308, np.eye(4)), r"finite"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused(pose, message):
    with pytest.raises(SceneError, match=message):
        Camera.from_intrinsics(K, pose, SIZE)


@pytest.mark.parametrize("size", [(0, 48), (64, -1), (64.0, 48), (True, 48), 64, (64, 48, 3), None, ("64", "48")])
def test_a_size_that_is_none_is_refused(size):
    with pytest.raises(SceneError, match="camera's"):
        Camera.from_intrinsics(K, np.eye(4), size)


@pytest.mark.parametrize(
    "arguments", [{"convention": "blender"}, {"convention": None}, {"pixel_centres": 0.5}, {"pixel_centres": "corner"}]
)
def test_an_unknown_convention_is_refused(arguments):
    with pytest.raises(SceneError, match="must be one of"):
        Camera.from_intrinsics(K, np.eye(4), SIZE, **arguments)


def test_a_camera_without_a_lens_has_no_size():
    with pytest.raises(SceneError, match="has no size"):
        Camera((0, 0, 5), (0, 0, 0)).rays()
    with pytest.raises(SceneError, match="height of a camera's picture"):
        Camera((0, 0, 5), (0, 0, 0)).rays(3, 0)


def test_the_field_of_view_of_a_lens_is_its_own():
    lens = Lens(50.0, 50.0, 32.0, 24.0, 0.0, *SIZE)
    camera = Camera((0, 0, 5), (0, 0, 0), lens=lens)
    assert camera.fov == pytest.approx(2 * np.degrees(np.arctan(24 / 50)))
    with pytest.raises(SceneError, match="follows from its lens"):
        Camera((0, 0, 5), (0, 0, 0), fov=60, lens=lens)
    with pytest.raises(SceneError, match="must be a Lens"):
        Camera((0, 0, 5), (0, 0, 0), lens=K)


class TestOrbit:
    CAMERA = Camera((3, 1, 4), (1, 0, 0.5), up=(0, 2, 0), fov=40)

    def test_four_quarters_come_back(self):
        camera = self.CAMERA
        for _ in range(4):
            camera = camera.orbit(90)
        assert_allclose(camera.eye, self.CAMERA.eye, atol=1e-14)
        assert camera.look_at == self.CAMERA.look_at
        assert camera.fov == 40

    @pytest.mark.parametrize("degrees", [-200, 0, 33, 1e6])
    def test_it_looks_at_the_point_from_the_same_distance_and_height(self, degrees):
        camera = self.CAMERA.orbit(degrees)
        assert camera.eye[1] == pytest.approx(1, abs=1e-12)
        assert np.linalg.norm(np.subtract(camera.eye, camera.look_at)) == pytest.approx(np.sqrt(4 + 1 + 12.25))
        assert_allclose(camera.axes()[1] @ [0, 1, 0], self.CAMERA.axes()[1] @ [0, 1, 0], atol=1e-12)

    def test_it_turns_counterclockwise_seen_from_above(self):
        assert_allclose(Camera((0, 0, 5), (0, 0, 0)).orbit(90).eye, [5, 0, 0], atol=1e-15)

    def test_a_point_and_an_axis_of_ones_own(self):
        camera = Camera((0, 0, 5), (0, 0, 0)).orbit(90, about=(1, 0, 5), axis=(0, 0, 3))
        assert_allclose(camera.eye, [1, -1, 5], atol=1e-15)
        assert_allclose(camera.look_at, [1, -1, 0], atol=1e-14)
        assert_allclose(camera.up, [-1, 0, 0], atol=1e-15)

    def test_a_calibrated_camera_turns_as_a_whole(self):
        pose, turn = make_pose(8), trimesh.transformations.rotation_matrix(np.radians(25), [0, 0, 1], [1, 2, 3])
        turned = Camera.from_intrinsics(K, pose, SIZE).orbit(25, about=(1, 2, 3), axis=(0, 0, 1))
        assert_allclose(turned.camera_to_world(), turn @ pose, atol=1e-12)
        with pytest.raises(SceneError, match="as `about`"):
            Camera.from_intrinsics(K, pose, SIZE).orbit(25)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"degrees": float("nan")}, "degrees .* must be a finite number"),
            ({"degrees": "90"}, "degrees .* must be a finite number"),
            ({"degrees": True}, "degrees .* must be a finite number"),
            ({"degrees": 90, "axis": (0, 0, 0)}, "must not be zero"),
            ({"degrees": 90, "about": (0, 0)}, "three finite numbers"),
        ],
    )
    def test_an_invalid_turn_is_refused(self, arguments, message):
        with pytest.raises(SceneError, match=message):
            self.CAMERA.orbit(**arguments)

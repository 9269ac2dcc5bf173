"""Images for programs against formulas: spheres and a wall, seen by cameras of known matrices."""

import numpy as np
import pytest

import clbvh
from clbvh import Camera, ConfigError, Images, Mesh, Scene, SceneError, Spheres, Transform

WIDTH, HEIGHT = 60, 44
K = np.array([[50.0, 0.0, 28.0], [0.0, 55.0, 23.5], [0.0, 0.0, 1.0]])
POSE = np.array([[1.0, 0, 0, 0.4], [0, 0.6, -0.8, 4.0], [0, 0.8, 0.6, -3.2], [0, 0, 0, 1.0]])
CAMERA = Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT))

# Of the spheres by instance; the wall is instance 2.
CENTRES = np.array([[0.0, 0.0, 0.0], [1.5, 0.5, 0.2]])
RADII = np.array([1.0, 0.5])
WALL_Z = 2.5
WALL = Mesh.from_arrays(
    np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 4.0,
    [[0, 1, 2], [0, 2, 3]],
    name="wall",
    appearance=clbvh.Appearance(uvs=np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[[[0, 1, 2], [0, 2, 3]]]),
)
# Each channel with the number of its values, their type, and what a miss holds.
CHANNELS = {
    "rgb": (3, np.uint8, None), "colour": (3, np.float32, None), "alpha": (0, np.float32, 0),
    "depth": (0, np.float32, np.inf), "range": (0, np.float32, np.inf), "normal": (3, np.float32, 0),
    "normal_camera": (3, np.float32, 0), "shading_normal": (3, np.float32, 0),
    "shading_normal_camera": (3, np.float32, 0), "position": (3, np.float64, np.nan),
    "instance_id": (0, np.int32, -1), "geometry_id": (0, np.int32, -1), "prim_id": (0, np.int32, -1),
    "barycentric": (2, np.float32, np.nan), "uv": (2, np.float32, np.nan), "motion": (2, np.float32, np.nan),
}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    scene = Scene()
    ball = scene.add(Spheres([[9, 9, 9], [0, 0, 0]], [0.01, 1.0]), name="ball")
    scene.place(ball, name="large")
    scene.place(ball, Transform(scale=RADII[1], translate=tuple(CENTRES[1])), name="small")
    scene.place(scene.add(WALL), Transform(translate=(0, 0, WALL_Z)), name="back")
    return scene


@pytest.fixture(scope="module")
def renderer(scene):
    with clbvh.Renderer(scene, shading="lambert") as opened:
        yield opened


@pytest.fixture(scope="module")
def images(renderer):
    return renderer.images(tuple(CHANNELS), camera=CAMERA, next_camera=CAMERA)


def make_directions():
    """Return the unit directions through the pixel centres, by the matrices alone."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    directions = np.stack((columns, rows, np.ones_like(rows)), axis=-1) @ np.linalg.inv(K).T @ POSE[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


EYE, DIRECTIONS = POSE[:3, 3], make_directions()


def cast():
    """Return t, (h, w), infinite on a miss, and the instance of each pixel, by formulas."""
    answers = []
    for centre, radius in zip(CENTRES, RADII, strict=True):
        half_b = DIRECTIONS @ (EYE - centre)
        square = half_b**2 - ((EYE - centre) @ (EYE - centre) - radius**2)
        answers.append(np.where(square > 0, -half_b - np.sqrt(np.maximum(square, 0)), np.inf))
    t = (WALL_Z - EYE[2]) / DIRECTIONS[..., 2]
    is_inside = (np.abs((EYE + t[..., None] * DIRECTIONS)[..., :2]) < 4).all(axis=-1)
    answers.append(np.where((t > 0) & is_inside, t, np.inf))
    t = np.min(answers, axis=0)
    return t, np.where(np.isinf(t), -1, np.argmin(answers, axis=0))


T, INSTANCE = cast()
IS_HIT = INSTANCE >= 0


def test_every_channel_has_its_shape_type_and_misses(images):
    assert isinstance(images, Images)
    assert tuple(images) == tuple(CHANNELS)
    assert (images.geometry_names, images.instance_names) == (("ball", "wall"), ("large", "small", "back"))
    np.testing.assert_allclose(images.intrinsics, K)
    for name, (width, dtype, missed) in CHANNELS.items():
        assert images[name].shape == (HEIGHT, WIDTH, width)[: 3 if width else 2], name
        assert images[name].dtype == dtype, name
        if missed is not None:
            np.testing.assert_array_equal(images[name][~IS_HIT], np.full_like(images[name][~IS_HIT], missed))


def test_ids_distances_and_positions(images):
    assert all(((instance == INSTANCE).sum() > 20) for instance in (-1, 0, 1, 2))
    assert (images["instance_id"] == INSTANCE).all()
    assert (images["geometry_id"] == np.array([0, 0, 1, -1])[INSTANCE]).all()
    assert (images["prim_id"][(INSTANCE == 0) | (INSTANCE == 1)] == 1).all()
    assert set(images["prim_id"][INSTANCE == 2]) == {0, 1}
    np.testing.assert_allclose(images["range"], T, rtol=2e-6)
    np.testing.assert_allclose(images["depth"], T * (DIRECTIONS @ POSE[:3, 2]), rtol=2e-6)
    expected = (EYE + np.where(IS_HIT, T, 0)[..., None] * DIRECTIONS)[IS_HIT]
    np.testing.assert_allclose(images["position"][IS_HIT], expected, atol=1e-12)


def test_normals_face_the_camera(images):
    expected = np.zeros((HEIGHT, WIDTH, 3))
    for instance in (0, 1):
        seen = instance == INSTANCE
        expected[seen] = (images["position"][seen] - CENTRES[instance]) / RADII[instance]
    expected[INSTANCE == 2] = (0, 0, -1)  # the wall's own normal is +z, away from the camera
    for name in ("normal", "shading_normal"):
        np.testing.assert_allclose(images[name], expected, atol=2e-6)
        np.testing.assert_allclose(images[f"{name}_camera"], expected @ POSE[:3, :3], atol=2e-6)


def test_texture_and_barycentric_coordinates(renderer, images):
    seen, hits = INSTANCE == 2, renderer.render(camera=CAMERA).hits
    np.testing.assert_allclose(images["uv"][seen], images["position"][seen][:, :2] / 8 + 0.5, atol=1e-6)
    assert np.isnan(images["uv"][~seen]).all()
    assert (images["barycentric"][IS_HIT] == np.stack((hits.u, hits.v), axis=-1)[IS_HIT].astype(np.float32)).all()


def decode_srgb(rgb):
    shares = rgb / 255
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def test_colours_of_one_ray_are_decoded_and_those_of_samples_are_their_means(renderer, images):
    assert (images["rgb"] == renderer.render(camera=CAMERA).rgb).all()
    np.testing.assert_allclose(images["colour"], decode_srgb(images["rgb"]), atol=1e-6)
    assert (images["alpha"] == IS_HIT).all()
    means = renderer.images(("rgb", "colour", "alpha"), camera=CAMERA, shading="studio")
    rgb, colour = means["rgb"].astype(int), means["colour"].astype(np.float64)
    assert (decode_srgb(np.maximum(rgb - 0.51, 0)) <= colour + 1e-6).all()
    assert (colour <= decode_srgb(rgb + 0.51) + 1e-6).all()
    assert np.abs(colour - decode_srgb(rgb)).max() > 1e-4  # more than 8 bits
    alpha = means["alpha"]
    assert 0 < np.count_nonzero((alpha > 0) & (alpha < 1)) < alpha.size / 4
    assert ((alpha > 0.5) == IS_HIT).mean() > 0.95


def test_motion_of_a_shifted_camera_is_focal_length_times_shift_over_depth(renderer, images):
    assert np.abs(images["motion"][IS_HIT]).max() < 1e-9
    pose = POSE.copy()
    pose[:3, 3] += POSE[:3, :3] @ [0.03, -0.02, 0.0]  # along the camera's x and y
    shifted = Camera.from_intrinsics(K, pose, (WIDTH, HEIGHT))
    moved = renderer.images(("motion", "depth"), camera=CAMERA, next_camera=shifted)
    expected = np.array([-50 * 0.03, 55 * 0.02]) / moved["depth"][IS_HIT][:, None]
    np.testing.assert_allclose(moved["motion"][IS_HIT], expected, rtol=1e-4, atol=1e-6)


def test_a_moved_instance_moves_alone_by_id_name_or_handle(renderer, scene):
    shift = np.array([0.1, 0.2, 0.0])
    moved = Transform(scale=RADII[1], translate=tuple(CENTRES[1] + POSE[:3, :3] @ shift))
    for key in (1, "small", scene.find("small")):
        images = renderer.images(("motion", "depth"), camera=CAMERA, next_transforms={key: moved})
        expected = np.array([50.0, 55.0]) * shift[:2] / images["depth"][INSTANCE == 1][:, None]
        np.testing.assert_allclose(images["motion"][INSTANCE == 1], expected, rtol=1e-4)
        assert np.abs(images["motion"][(INSTANCE == 0) | (INSTANCE == 2)]).max() < 1e-9


def test_other_channels_and_poses_are_refused(renderer):
    rows = [
        *((ConfigError, "channel", channels, {}) for channels in ((), ("colour", "glow"), 7)),
        (ConfigError, "needs a second pose", "motion", {"next_transforms": {}}),
        (SceneError, r"must be a clbvh\.Camera", "motion", {"next_camera": "left"}),
        (SceneError, "no instance 9", "motion", {"next_transforms": {9: np.eye(4)}}),
        (SceneError, "next transform", "motion", {"next_transforms": {0: np.eye(3)}}),
    ]
    for error, words, channels, pose in rows:
        with pytest.raises(error, match=words):
            renderer.images(channels, camera=CAMERA, **pose)
    images = renderer.images(["range", "depth", "range"], camera=CAMERA)
    assert tuple(images) == ("range", "depth")
    with pytest.raises(KeyError, match="the images have the channels range, depth"):
        images["normal"]

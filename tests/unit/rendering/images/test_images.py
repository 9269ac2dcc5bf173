"""Images for programs against formulas: spheres and a wall, seen by cameras of known matrices."""

from __future__ import annotations

import json

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
ALL = (
    "rgb", "colour", "alpha", "depth", "range", "normal", "normal_camera", "shading_normal", "shading_normal_camera",
    "position", "instance_id", "geometry_id", "primitive_id", "barycentric", "uv", "motion",
)  # fmt: skip


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
    step = Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT))
    return renderer.images(ALL, camera=CAMERA, next_camera=step)


def make_rays():
    """Return the eye and the unit directions through the pixel centres, by the matrices alone."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    local = np.stack((columns, rows, np.ones_like(rows)), axis=-1) @ np.linalg.inv(K).T
    directions = local @ POSE[:3, :3].T
    return POSE[:3, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def cast():
    """Return t, (h, w), infinite on a miss, and the instance of each pixel, by formulas."""
    eye, directions = make_rays()
    answers = []
    for centre, radius in zip(CENTRES, RADII, strict=True):
        half_b = directions @ (eye - centre)
        square = half_b**2 - ((eye - centre) @ (eye - centre) - radius**2)
        answers.append(np.where(square > 0, -half_b - np.sqrt(np.maximum(square, 0)), np.inf))
    t = (WALL_Z - eye[2]) / directions[..., 2]
    points = eye + t[..., None] * directions
    answers.append(np.where((t > 0) & (np.abs(points[..., :2]) < 4).all(axis=-1), t, np.inf))
    t = np.min(answers, axis=0)
    return t, np.where(np.isinf(t), -1, np.argmin(answers, axis=0))


T, INSTANCE = cast()


def test_the_view_shows_all_three_and_misses():
    assert all(((instance == INSTANCE).sum() > 20) for instance in (-1, 0, 1, 2))


def test_every_channel_has_its_shape_and_type(images):
    assert tuple(images) == ALL
    assert len(images) == len(ALL)
    widths = {"depth": 0, "range": 0, "alpha": 0, "barycentric": 2, "uv": 2, "motion": 2}
    for name, array in images.items():
        width = 0 if name.endswith("_id") else widths.get(name, 3)
        assert array.shape == (HEIGHT, WIDTH, width)[: 3 if width else 2], name
        expected = {"rgb": np.uint8, "position": np.float64}.get(name, np.int32 if "_id" in name else np.float32)
        assert array.dtype == expected, name


def test_ids(images):
    assert (images["instance_id"] == INSTANCE).all()
    assert (images["geometry_id"] == np.array([0, 0, 1, -1])[INSTANCE]).all()
    primitives = images["primitive_id"]
    assert (primitives[(INSTANCE == 0) | (INSTANCE == 1)] == 1).all()
    assert set(primitives[INSTANCE == 2]) == {0, 1}
    assert (primitives[INSTANCE == -1] == -1).all()


def test_distances(images):
    _, directions = make_rays()
    np.testing.assert_allclose(images["range"], T, rtol=2e-6)
    np.testing.assert_allclose(images["depth"], T * (directions @ POSE[:3, 2]), rtol=2e-6)
    assert np.isinf(images["depth"][INSTANCE == -1]).all()


def test_positions(images):
    eye, directions = make_rays()
    is_hit = INSTANCE >= 0
    expected = (eye + np.where(is_hit, T, 0)[..., None] * directions)[is_hit]
    np.testing.assert_allclose(images["position"][is_hit], expected, atol=1e-12)
    assert np.isnan(images["position"][~is_hit]).all()


@pytest.mark.parametrize("name", ["normal", "shading_normal"])
def test_normals_face_the_camera(images, name):
    expected = np.zeros((HEIGHT, WIDTH, 3))
    for instance in (0, 1):
        seen = instance == INSTANCE
        expected[seen] = (images["position"][seen] - CENTRES[instance]) / RADII[instance]
    expected[INSTANCE == 2] = (0, 0, -1)  # the wall's own normal is +z, away from the camera
    np.testing.assert_allclose(images[name], expected, atol=2e-6)
    np.testing.assert_allclose(images[f"{name}_camera"], expected @ POSE[:3, :3], atol=2e-6)
    assert (images[f"{name}_camera"][INSTANCE == 2] @ [0, 0, 1] < 0).all()


def see(mesh, *channels, transform=None):
    scene = Scene()
    view = clbvh.View(width=40, height=30)
    scene.place(scene.add(mesh), transform, colour=(1, 1, 1))
    return clbvh.render_images(scene, (*channels, "normal", "position"), view)


@pytest.mark.parametrize("placed", [False, True])
def test_shading_normals_are_smooth_up_to_a_crease(placed):
    ball = clbvh.make_shape("icosphere", triangles=320)
    move = Transform(scale=(1, 2, 1), rotate=(0, 0, 30)) if placed else None
    images = see(ball, "shading_normal", transform=move)
    seen = np.isfinite(images["position"]).all(axis=-1)
    inverse = np.linalg.inv(move.matrix[:3, :3]) if placed else np.eye(3)
    outwards = images["position"][seen] @ inverse.T @ inverse  # the gradient of |M^-1 x|^2
    outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)
    cosines = np.einsum("ij,ij->i", images["shading_normal"][seen], outwards)
    assert np.quantile(cosines, 0.02) > (0.99 if placed else 0.9995)
    assert np.quantile(np.einsum("ij,ij->i", images["normal"][seen], outwards), 0.02) < cosines.min()


def test_shading_normals_of_a_box_are_flat():
    box = clbvh.Mesh.from_arrays(
        [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)],
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]],
    )  # fmt: skip
    images = see(box, "shading_normal")
    assert (images["normal"] != 0).any()
    np.testing.assert_allclose(images["shading_normal"], images["normal"], atol=1e-6)


@pytest.mark.parametrize("side", [1, -1], ids=["of the corners", "other side"])
def test_shading_normals_of_a_file_are_taken_and_face_the_camera(side):
    tilted = np.array([0.6, 0.0, 0.8]) * side
    wall = Mesh.from_arrays(
        WALL.vertices, WALL.faces, appearance=clbvh.Appearance(normals=np.broadcast_to(tilted, (2, 3, 3)))
    )
    images = clbvh.render_images(
        wall, ("shading_normal", "alpha"), camera=Camera(eye=(0, 0, 9), look_at=(0, 0, 0)), width=20, height=16
    )
    seen = images["alpha"] > 0
    assert seen.any()
    np.testing.assert_allclose(images["shading_normal"][seen] - [0.6, 0, 0.8], 0, atol=1e-6)
    back = clbvh.render_images(
        wall, ("shading_normal", "alpha"), camera=Camera(eye=(0, 0, -9), look_at=(0, 0, 0)), width=20, height=16
    )
    np.testing.assert_allclose(back["shading_normal"][back["alpha"] > 0] + [0.6, 0, 0.8], 0, atol=1e-6)


def test_texture_coordinates_follow_the_wall(images):
    seen = INSTANCE == 2
    np.testing.assert_allclose(images["uv"][seen], images["position"][seen][:, :2] / 8 + 0.5, atol=1e-6)
    assert np.isnan(images["uv"][~seen]).all()


def test_barycentric_coordinates_are_those_of_the_hits(renderer, images):
    hits = renderer.render(camera=CAMERA).hits
    seen = INSTANCE >= 0
    assert (images["barycentric"][seen] == np.stack((hits.u, hits.v), axis=-1)[seen].astype(np.float32)).all()
    assert np.isnan(images["barycentric"][~seen]).all()


def decode_srgb(rgb):
    shares = rgb / 255
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def test_colours_of_one_ray_are_decoded(renderer, images):
    assert (images["rgb"] == renderer.render(camera=CAMERA).rgb).all()
    np.testing.assert_allclose(images["colour"], decode_srgb(images["rgb"]), atol=1e-6)
    assert (images["alpha"] == (INSTANCE >= 0)).all()


def test_colours_of_samples_are_their_means(renderer):
    images = renderer.images(("rgb", "colour", "alpha"), camera=CAMERA, shading="studio")
    rgb, colour = images["rgb"].astype(int), images["colour"].astype(np.float64)
    assert (decode_srgb(np.maximum(rgb - 0.51, 0)) <= colour + 1e-6).all()
    assert (colour <= decode_srgb(rgb + 0.51) + 1e-6).all()
    assert np.abs(colour - decode_srgb(rgb)).max() > 1e-4  # more than 8 bits
    alpha = images["alpha"]
    assert 0 < np.count_nonzero((alpha > 0) & (alpha < 1)) < alpha.size / 4
    assert ((alpha > 0.5) == (INSTANCE >= 0)).mean() > 0.95
    assert renderer.render(camera=CAMERA, shading="studio").film is None


def test_the_film_does_not_depend_on_bands(renderer, monkeypatch):
    whole = renderer.render(camera=CAMERA, shading="studio", samples=3, keeps_film=True).film
    monkeypatch.setattr(renderer._frames, "_band_pixels", 7 * WIDTH)
    cut = renderer.render(camera=CAMERA, shading="studio", samples=3, keeps_film=True).film
    assert cut.shape == (HEIGHT, WIDTH, 4)
    assert cut.tobytes() == whole.tobytes()


class TestMotion:
    def test_without_a_change_nothing_moves(self, images):
        seen = INSTANCE >= 0
        assert np.abs(images["motion"][seen]).max() < 1e-9
        assert np.isnan(images["motion"][~seen]).all()

    def test_a_shifted_camera_moves_pixels_by_focal_length_times_shift_over_depth(self, renderer):
        shift = np.array([0.03, -0.02, 0.0])  # along the camera's x and y
        pose = POSE.copy()
        pose[:3, 3] += POSE[:3, :3] @ shift
        images = renderer.images(
            ("motion", "depth"), camera=CAMERA, next_camera=Camera.from_intrinsics(K, pose, (WIDTH, HEIGHT))
        )
        seen = INSTANCE >= 0
        expected = -np.array([K[0, 0], K[1, 1]]) * shift[:2] / images["depth"][seen][:, None]
        np.testing.assert_allclose(images["motion"][seen], expected, rtol=1e-4, atol=1e-6)

    def test_a_moved_instance_moves_alone(self, renderer, scene):
        shift = np.array([0.1, 0.2, 0.0])
        moved = Transform(scale=RADII[1], translate=tuple(CENTRES[1] + POSE[:3, :3] @ shift))
        images = renderer.images(("motion", "depth"), camera=CAMERA, next_transforms={"small": moved})
        expected = np.array([50.0, 55.0]) * shift[:2] / images["depth"][INSTANCE == 1][:, None]
        np.testing.assert_allclose(images["motion"][INSTANCE == 1], expected, rtol=1e-4)
        others = (INSTANCE == 0) | (INSTANCE == 2)
        assert np.abs(images["motion"][others]).max() < 1e-9

    @pytest.mark.parametrize("key", [1, "small", "handle"])
    def test_instances_go_by_id_name_or_handle(self, renderer, scene, key):
        key = scene.find("small") if key == "handle" else key
        images = renderer.images("motion", camera=CAMERA, next_transforms={key: np.eye(4)})
        assert np.abs(images["motion"][INSTANCE == 1]).min() > 0.1
        assert np.abs(images["motion"][INSTANCE == 0]).max() < 1e-9

    def test_a_turned_sphere_carries_its_points(self, renderer):
        """A turn about the axis through the middle moves points, though the outline stays."""
        images = renderer.images(
            ("motion", "position"), camera=CAMERA, next_transforms={0: Transform(rotate=(0, 0, 90))}
        )
        seen = INSTANCE == 0
        turned = images["position"][seen] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        local = (turned - POSE[:3, 3]) @ POSE[:3, :3]
        pixels = (local / local[:, 2:] @ K.T)[:, :2]
        rows, columns = np.nonzero(seen)
        np.testing.assert_allclose(images["motion"][seen], pixels - np.stack((columns, rows), -1) - 0.5, atol=1e-4)

    @pytest.mark.parametrize("scaled", [False, True])
    def test_one_mesh_moves_from_where_its_scene_has_it(self, scaled):
        first = Transform(scale=2.0, translate=(1, 0, 0)) if scaled else Transform()
        scene = Scene()
        scene.place(scene.add(clbvh.make_shape("icosphere", triangles=320)), first)
        second = Transform(scale=first.scale, translate=tuple(np.add(first.translate, (0, 0.1, 0))))
        camera = Camera(eye=(1, 0, 9), look_at=(1, 0, 0), fov=50)
        images = clbvh.render_images(
            scene, ("motion", "depth"), camera=camera, next_transforms={0: second}, width=40, height=30
        )
        seen = np.isfinite(images["depth"])
        focal = 15 / np.tan(np.radians(25))
        expected = np.stack((0 * images["depth"][seen], -focal * 0.1 / images["depth"][seen]), axis=-1)
        np.testing.assert_allclose(images["motion"][seen], expected, rtol=1e-4, atol=1e-6)

    def test_an_instance_that_came_later_is_refused(self):
        scene = Scene()
        ball = scene.add(Spheres([[0, 0, 0]], 1.0))
        scene.place(ball)
        with clbvh.Renderer(scene, width=8, height=6) as renderer:
            late = scene.place(ball, Transform(translate=(3, 0, 0)))
            with pytest.raises(SceneError, match="instance"):
                renderer.images("motion", next_transforms={late: np.eye(4)})

    def test_behind_the_next_camera_is_nowhere(self, renderer):
        back = Camera(eye=(0, 0, -20), look_at=(0, 0, -30))
        assert np.isnan(renderer.images("motion", camera=CAMERA, next_camera=back)["motion"]).all()

    def test_without_a_second_pose_it_is_refused_before_the_work(self, renderer):
        with pytest.raises(ConfigError, match="needs a second pose"):
            renderer.images("motion", camera=CAMERA)
        with pytest.raises(ConfigError, match="needs a second pose"):
            renderer.images("motion", camera=CAMERA, next_transforms={})

    @pytest.mark.parametrize(
        ("pose", "words"),
        [
            ({"next_camera": "left"}, "must be a clbvh.Camera"),
            ({"next_transforms": [np.eye(4)]}, "must be a mapping"),
            ({"next_transforms": {9: np.eye(4)}}, "no instance 9"),
            ({"next_transforms": {"gone": np.eye(4)}}, "gone"),
            ({"next_transforms": {0: np.zeros((4, 4))}}, "next transform of 0"),
            ({"next_transforms": {0: np.eye(3)}}, r"must be a matrix of shape \(4, 4\)"),
        ],
        ids=["camera", "list", "id", "name", "singular", "shape"],
    )
    def test_other_poses_are_refused(self, renderer, pose, words):
        with pytest.raises(SceneError, match=words):
            renderer.images("motion", camera=CAMERA, **pose)


@pytest.mark.parametrize(
    "projection", [clbvh.Orthographic(5.0), clbvh.Fisheye(220.0), clbvh.Panorama()], ids=["flat", "fisheye", "panorama"]
)
def test_cameras_of_other_kinds(renderer, projection, tmp_path):
    camera = Camera(eye=(0.5, 0.8, -3), look_at=(0, 0, 0), projection=projection)
    images = renderer.images(
        ("depth", "range", "position", "motion"), camera=camera, next_camera=camera, width=40, height=30
    )
    seen = images["range"] < np.inf
    assert seen.sum() > 50
    origins, directions = camera.rays(40, 30)
    points = origins[seen] + directions[seen] * images["range"][seen][:, None]
    np.testing.assert_allclose(images["position"][seen], points, atol=1e-5)
    depth = (points - camera.eye) @ camera.axes()[2]
    np.testing.assert_allclose(images["depth"][seen], depth, atol=1e-5)
    assert np.abs(images["motion"][seen]).max() < 1e-6
    assert images.intrinsics is None
    images.save(tmp_path / "a.png")
    assert "intrinsics" not in json.loads((tmp_path / "a.json").read_text())


def test_nothing_hit_is_all_misses(renderer):
    away = Camera(eye=(0, 0, -20), look_at=(0, 0, -30))
    images = renderer.images(ALL, camera=away, next_camera=away, width=5, height=4)
    assert np.isinf(images["depth"]).all()
    assert np.isinf(images["range"]).all()
    for name in ("normal", "normal_camera", "shading_normal", "alpha"):
        assert not images[name].any()
    for name in ("position", "barycentric", "uv", "motion"):
        assert np.isnan(images[name]).all()
    for name in ("instance_id", "geometry_id", "primitive_id"):
        assert (images[name] == -1).all()


def test_the_camera_and_the_names_are_kept(images):
    assert isinstance(images, Images)
    np.testing.assert_allclose(images.intrinsics, K)
    np.testing.assert_allclose(images.camera_to_world, POSE, atol=1e-12)
    assert images.geometry_names == ("ball", "wall")
    assert images.instance_names == ("large", "small", "back")
    assert (images.width, images.height) == (WIDTH, HEIGHT)


def test_channels_are_named_once(renderer):
    assert tuple(renderer.images(["range", "depth", "range"], camera=CAMERA)) == ("range", "depth")
    with pytest.raises(KeyError, match="the images have the channels depth"):
        renderer.images("depth", camera=CAMERA)["normal"]


@pytest.mark.parametrize("channels", [(), ("colour", "glow"), 7, ("depth", 3), ([],)], ids=str)
def test_other_channels_are_refused(renderer, channels):
    with pytest.raises(ConfigError, match="channel"):
        renderer.images(channels)


def test_geometry_alone_casts_no_ray_to_the_light(renderer, monkeypatch):
    shadings = []
    render = renderer.render
    monkeypatch.setattr(
        renderer, "render", lambda view, **given: shadings.append(view.shading) or render(view, **given)
    )
    renderer.images(("depth", "normal"), camera=CAMERA, shading="lambert+shadow")
    renderer.images(("depth", "alpha"), camera=CAMERA, shading="lambert+shadow")
    renderer.images(("depth", "rgb"), camera=CAMERA, shading="lambert+shadow")
    assert shadings == ["normal", "lambert+shadow", "lambert+shadow"]


def test_geometry_of_a_view_with_many_samples_takes_one():
    ball = clbvh.make_shape("icosphere", triangles=80)
    images = clbvh.render_images(ball, "depth", shading="studio", samples=64, width=8, height=8)
    assert np.isfinite(images["depth"]).any()

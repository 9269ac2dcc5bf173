"""A renderer of many pictures: each is what `render` makes, and nothing is made twice."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Camera, Light, Mesh, Renderer, RenderOptions, Scene
from clbvh.device import program
from clbvh.device.session import DeviceSession
from clbvh.errors import ConfigError, MeshError, QueryError, SceneError
from clbvh.rendering import painters as painters_module

from ..concurrency.threads import run_in_threads

SIZE = (80, 60)
SCENE = clbvh.make_shape("knot", triangles=4000, seed=1)
VIEW = clbvh.View(width=SIZE[0], height=SIZE[1], up="y")
LAYOUTS = ("bvh2", "bvh4", "bvh8")

# Off centre, wider than high pixels, skew; and a pose that looks at the knot's middle.
K = np.array([[95.0, 6.0, 20.0], [0.0, 60.0, 41.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def renderer():
    with Renderer(SCENE, VIEW) as opened:
        yield opened


@pytest.fixture(scope="module")
def pose(renderer):
    return renderer.camera.camera_to_world("opencv")


@pytest.fixture(scope="module")
def lens_camera(pose):
    return Camera.from_intrinsics(K, pose, SIZE)


def same_picture(one, other):
    return (one.rgb == other.rgb).all() and (one.found == other.found).all() and one.camera == other.camera


class TestPictures:
    @pytest.mark.parametrize(
        "changes",
        [
            {},
            {"shading": "normal"},
            {"width": 31, "height": 77},
            {"camera": Camera((3, 1, 4), (0, 0, 0), fov=60), "shading": "depth"},
            {"light": Light(direction=(1, 2, 3), colour=(1, 0, 0))},
            {"surface": (0.1, 0.9, 0.3), "background": ((0, 0, 0), (1, 1, 1))},
        ],
    )
    def test_they_are_those_of_render(self, renderer, changes):
        expected = clbvh.render(SCENE, VIEW.changed(**changes))
        # After a picture of another size, which has left its memory.
        renderer.render(width=100, height=90, shading="depth")
        assert same_picture(renderer.render(**changes), expected)
        assert same_picture(clbvh.render(SCENE, VIEW, **changes), expected)

    def test_one_picture_leaves_nothing_to_the_next(self, renderer):
        first = renderer.render()
        renderer.render(shading="normal", width=13, height=200, light_direction=(0, 0, 1), background=(1, 0, 0))
        assert same_picture(renderer.render(), first)

    def test_a_light_may_be_changed_and_a_background_be_one_colour(self, renderer):
        light = Light(direction=(0.0, 1.0, 0.0))
        assert same_picture(renderer.render(light_direction=(0, 1, 0)), renderer.render(light=light))
        gradient = ((0.2, 0.3, 0.4),) * 2
        assert same_picture(renderer.render(background=(0.2, 0.3, 0.4)), renderer.render(background=gradient))
        assert same_picture(renderer.render(background=np.array([0.2, 0.3, 0.4])), renderer.render(background=gradient))

    def test_a_turn_keeps_device_tree_kernels_and_buffers(self, renderer, monkeypatch):
        renderer.render()
        made = []
        for owner, name in ((DeviceSession, "allocate"), (DeviceSession, "_open"), (program, "_compile")):
            monkeypatch.setattr(owner, name, lambda *_, **__: made.append(1))
        before = renderer.render(camera=renderer.camera)
        turned = [renderer.render(camera=renderer.camera.orbit(degrees)) for degrees in (0, 90, 180, 360)]
        assert made == []
        assert same_picture(before, turned[0])
        assert (turned[1].rgb != before.rgb).any()
        assert (turned[3].found["prim_id"] == before.found["prim_id"]).mean() > 0.99

    def test_a_turntable_shows_the_whole_mesh_all_the_way(self, renderer):
        cameras = renderer.turntable(8, width=60, height=40)
        found = np.array([renderer.render(camera=camera, width=60, height=40).hits.is_hit for camera in cameras])
        assert found.shape == (8, 40, 60)
        assert found.any(axis=0)[1:-1, 1:-1].mean() > 0.3
        assert not found[:, [0, -1]].any()
        assert not found[:, :, [0, -1]].any()
        for count in (0, -1, 2.5, True, None, "8"):
            with pytest.raises(SceneError, match="at least one camera"):
                renderer.turntable(count)

    def test_timings_are_those_of_the_picture_alone(self, renderer):
        picture = renderer.render()
        once = clbvh.render(SCENE, VIEW)
        assert list(picture.timings) == list(renderer.timings) == list(once.timings)
        assert picture.timings["kernel"] > 0
        assert picture.timings["build"] == picture.timings["load"] == picture.timings["compile"] == 0
        for timings in (picture.timings, once.timings, renderer.timings):
            parts = sum(ms for phase, ms in timings.items() if phase != "total")
            assert parts == pytest.approx(timings["total"], rel=0.01)

    def test_every_pixel_is_validated(self, lens_camera):
        with Renderer(SCENE, VIEW, options=RenderOptions(validate=True)) as renderer:
            assert renderer.render(width=20, height=15).validated_pixels == 300
            assert renderer.render(camera=lens_camera, width=40).validated_pixels == 1200

    def test_the_scenes_camera_follows_the_shape_of_the_picture(self, renderer):
        high = renderer.render(width=30, height=90)
        assert high.camera == renderer.find_camera(width=30, height=90)
        assert renderer.render().camera == renderer.camera != high.camera

    def test_other_memory_of_the_device_makes_narrower_bands_for_good(self, renderer, monkeypatch):
        expected = renderer.render()
        monkeypatch.setattr(painters_module, "BAND_PIXELS", SIZE[0] * 7)
        with Renderer(SCENE, VIEW) as banded:
            assert same_picture(banded.render(), expected)


class TestLenses:
    @pytest.mark.parametrize("layout", [*LAYOUTS, "brute"])
    def test_a_lens_sees_what_its_rays_hit(self, lens_camera, layout):
        options = RenderOptions(builder="brute") if layout == "brute" else RenderOptions(layout=layout)
        with Renderer(SCENE, VIEW, options=options) as renderer:
            picture = renderer.render(camera=lens_camera)
        assert picture.rgb.shape == (60, 80, 3)
        with clbvh.Tracer(picture.mesh) as tracer:
            traced = tracer.closest_hit(*lens_camera.rays())
        assert 0.1 < traced.is_hit.mean() < 0.9
        same = traced.prim_id == picture.hits.prim_id
        # The kernel makes its rays in float32: at an edge the neighbour may be hit.
        assert same.mean() > 0.995
        assert (traced.t[same] == picture.hits.t[same]).all()

    def test_a_plain_lens_is_a_field_of_view(self, renderer):
        plain = renderer.camera
        lens = Camera.from_intrinsics(plain.intrinsics(*SIZE), plain.camera_to_world("opengl"), SIZE, "opengl")
        for shading in ("normal", "depth", "lambert+shadow"):
            one, other = renderer.render(camera=plain, shading=shading), renderer.render(camera=lens, shading=shading)
            assert (one.found["prim_id"] == other.found["prim_id"]).mean() > 0.995
            assert (np.abs(one.rgb.astype(int) - other.rgb).max(axis=2) > 1).mean() < 0.005

    def test_a_part_of_a_picture_is_a_lens_off_centre(self, renderer, lens_camera, pose):
        whole = renderer.render(camera=lens_camera)
        left, top, width, height = 33, 7, 25, 40
        moved = K - [[0, 0, left], [0, 0, top], [0, 0, 0]]
        part = renderer.render(camera=Camera.from_intrinsics(moved, pose, (width, height)), shading="lambert")
        inside = whole.hits.prim_id[top : top + height, left : left + width]
        same = part.hits.prim_id == inside
        assert same.mean() > 0.995
        assert part.hits.count > 100
        t = whole.hits.t[top : top + height, left : left + width]
        np.testing.assert_allclose(part.hits.t[same], t[same], rtol=1e-12)

    def test_depth_is_along_the_optical_axis(self, lens_camera):
        # A wall across the optical axis, at depth 3.
        right, up, forward = lens_camera.axes()
        middle = np.add(lens_camera.eye, 3 * forward)
        corners = [middle + x * right + y * up for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
        behind = [corner + 1.0 * forward for corner in corners]
        wall = np.array(corners + behind), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
        picture = clbvh.render(wall, camera=lens_camera, shading="depth")
        assert picture.hits.count == SIZE[0] * SIZE[1]
        np.testing.assert_allclose(picture.depth, 3, rtol=1e-12)
        assert picture.hits.t.max() > 3.2
        assert np.ptp(picture.rgb) <= 1  # one shade of grey
        assert 20 < picture.rgb[0, 0, 0] < 240

    def test_the_size_is_that_of_the_lens(self, renderer, lens_camera):
        assert renderer.render(camera=lens_camera).rgb.shape == (60, 80, 3)
        assert renderer.render(camera=lens_camera, height=30).rgb.shape == (30, 40, 3)
        with pytest.raises(SceneError, match="another aspect ratio"):
            renderer.render(camera=lens_camera, width=80, height=80)

    def test_no_lens_is_too_wide_or_too_long(self, renderer, pose):
        for focal in (1e-6, 1e-2, 1e4, 1e9):
            camera = Camera.from_intrinsics([[focal, 0, 40], [0, focal, 30], [0, 0, 1]], pose, SIZE)
            picture = renderer.render(camera=camera)
            assert np.isfinite(picture.hits.t[picture.hits.is_hit]).all()


class TestSources:
    MESH = clbvh.make_shape("icosphere", triangles=320)

    def sources(self, folder):
        path = folder / "sphere.ply"
        trimesh.Trimesh(self.MESH.vertices, self.MESH.faces, process=False).export(path)
        (folder / "sphere.toml").write_text('[[object]]\npath = "sphere.ply"\n')
        return {
            "mesh": self.MESH,
            "trimesh": trimesh.Trimesh(self.MESH.vertices, self.MESH.faces, process=False),
            "arrays": (self.MESH.vertices, self.MESH.faces),
            "path": str(path),
            "Path": path,
            "scene file": folder / "sphere.toml",
            "tree": clbvh.build(self.MESH),
            "scene of a mesh": Scene(self.MESH),
            "scene of arrays": Scene((self.MESH.vertices, self.MESH.faces)),
            "scene of a path": Scene(path),
        }

    def test_all_that_is_a_mesh_is_drawn(self, tmp_path):
        for name, source in self.sources(tmp_path).items():
            with Renderer(source) as renderer:
                assert isinstance(renderer.mesh, Mesh)
                # A PLY of trimesh is in float32.
                assert abs(renderer.render(width=64, height=48).hits.count - 1565) < 3, name

    def test_a_tree_is_not_built_again(self):
        bvh = clbvh.build(self.MESH, quality="high")
        picture = clbvh.render(bvh, options=RenderOptions(validate=True))
        assert picture.bvh is bvh
        assert picture.workers == 0

    def test_a_shipped_scene_is_drawn_by_its_name(self):
        assert clbvh.render("knot", width=16, height=9).rgb.shape == (9, 16, 3)

    @pytest.mark.parametrize("source", [None, 5, np.eye(3), [], {"mesh": 1}, object(), b"knot", (1, 2, 3)])
    def test_anything_else_is_one_sentence_of_what_is_accepted(self, source):
        with pytest.raises(MeshError, match=r"expected .*a clbvh\.Mesh, .*, not") as caught:
            Renderer(source)
        assert "\n" not in str(caught.value)

    def test_a_missing_file_is_an_error_of_its_own(self, tmp_path):
        with pytest.raises(MeshError, match="no such"):
            Renderer(tmp_path / "missing.ply")
        with pytest.raises(SceneError, match="no such file"):
            Renderer(tmp_path / "missing.toml")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"camera": "front"}, r"camera must be a clbvh\.Camera"),
            ({"camera": np.eye(4)}, r"must be a clbvh\.Camera"),
            ({"width": 0}, "width must be"),
            ({"height": 1e9}, "height must be"),
            ({"shading": "phong"}, "shading must be one of"),
            ({"shading": []}, "shading must be one of"),
            ({"light_direction": (0, 0, 0)}, "must not be zero"),
            ({"light": 5}, r"light must be a clbvh\.Light"),
            ({"light_direction": "above"}, "light_direction must be three finite numbers"),
            ({"surface": (1, 2)}, "three finite numbers"),
            ({"background": 1}, "background"),
            ({"background": "black"}, "background"),
            ({"background": []}, "background"),
            ({"background": (1, 2)}, "background"),
            ({"background": {"top": 1}}, "background"),
        ],
    )
    def test_a_wrong_value_is_refused(self, renderer, arguments, message):
        with pytest.raises(SceneError, match=message):
            renderer.render(**arguments)

    def test_wrong_options_are_refused(self):
        with pytest.raises(ConfigError, match="RenderOptions"):
            Renderer(SCENE, VIEW, options={"device": "cpu"})


class TestClosing:
    def test_a_closed_renderer_says_so(self):
        with Renderer(SCENE, VIEW) as renderer:
            assert not renderer.is_closed
            assert renderer.memory_bytes > 4000 * 36
        assert renderer.is_closed
        renderer.close()
        with pytest.raises(QueryError, match="the renderer is closed"):
            renderer.render()
        # What a closed renderer has made and knows stays.
        assert repr(renderer).startswith("Renderer('knot', device=")
        assert renderer.camera.fov == 35

    def test_a_failure_gives_the_devices_memory_back(self, monkeypatch):
        closed, close = [], DeviceSession.close
        monkeypatch.setattr(DeviceSession, "close", lambda self: closed.append(self) or close(self))

        def fail(*_, **__):
            raise SceneError("broken")

        monkeypatch.setattr(painters_module.Painters, "painter", fail)
        with pytest.raises(SceneError, match="broken"):
            Renderer(SCENE, VIEW)
        assert len(closed) == 1

    def test_threads_share_a_renderer(self, renderer):
        cameras = [renderer.camera.orbit(40 * number) for number in range(6)]
        sizes = [(31 + 10 * number, 50) for number in range(6)]
        expected = [
            renderer.render(camera=camera, width=size[0], height=size[1])
            for camera, size in zip(cameras, sizes, strict=True)
        ]

        def draw_all(seed):
            for number in np.random.default_rng(seed).permutation(6):
                picture = renderer.render(camera=cameras[number], width=sizes[number][0], height=sizes[number][1])
                assert same_picture(picture, expected[number])
                assert picture.timings["kernel"] > 0

        run_in_threads(*(lambda seed=seed: draw_all(seed) for seed in range(6)))

    def test_closing_waits_for_pictures_of_other_threads(self):
        opened = Renderer(SCENE, VIEW)
        begun, pictures = threading.Event(), []

        def draw():
            try:
                while True:
                    pictures.append(opened.render(width=200, height=150))
                    begun.set()
            except QueryError as error:
                pictures.append(error)

        def close():
            assert begun.wait(60)
            opened.close()

        run_in_threads(draw, draw, close)
        assert sum(isinstance(picture, QueryError) for picture in pictures) == 2
        assert opened._session._buffers == set()


def test_a_fault_of_the_mesh_is_said_before_one_of_the_device(tmp_path):
    wrong = clbvh.RenderOptions(device="no such device")
    with pytest.raises(clbvh.MeshError, match="missing"):
        clbvh.Renderer(str(tmp_path / "missing.ply"), options=wrong)
    with pytest.raises(clbvh.DeviceError, match="no such device"):
        clbvh.Renderer(clbvh.make_shape("icosphere", triangles=80), options=wrong)

"""A renderer of many pictures: each is what `render` makes, nothing is made twice, and it can be shared and closed."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Camera, Light, Renderer, RenderOptions, Scene, SceneError
from clbvh.device import program
from clbvh.device.session import DeviceSession
from clbvh.errors import MeshError, QueryError
from clbvh.rendering import painters

from ..concurrency.threads import run_in_threads
from .test_pictures import KNOT, same_picture

SIZE = (80, 60)
VIEW = clbvh.View(width=SIZE[0], height=SIZE[1], up="y", shading="lambert+shadow")

# Off centre, wider than high pixels, skew; the pose looks at the knot's middle.
K = np.array([[95.0, 6.0, 20.0], [0.0, 60.0, 41.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def renderer():
    with Renderer(KNOT, VIEW) as opened:
        yield opened


@pytest.fixture(scope="module")
def lens_camera(renderer):
    return Camera.from_intrinsics(K, renderer.camera.camera_to_world(), SIZE)


def test_pictures_are_those_of_render_and_leave_nothing_to_the_next(renderer):
    first = renderer.render()
    rows = [
        {"shading": "normal"},
        {"width": 31, "height": 77},
        {"camera": Camera((3, 1, 4), (0, 0, 0), fov=60), "shading": "depth"},
        {"light": Light(direction=(1, 2, 3), colour=(1, 0, 0))},
        {"surface": (0.1, 0.9, 0.3), "background": ((0, 0, 0), (1, 1, 1))},
    ]
    for changes in rows:
        assert same_picture(renderer.render(**changes), clbvh.render(KNOT, VIEW, **changes)), changes
        assert same_picture(renderer.render(), first)
    # The scene's camera follows the shape of the picture.
    assert renderer.render(width=30, height=90).camera == renderer.find_camera(width=30, height=90) != renderer.camera


def test_a_turn_keeps_device_tree_kernels_and_buffers(renderer, monkeypatch):
    renderer.render()
    made = []
    for owner, name in ((DeviceSession, "allocate"), (DeviceSession, "_open"), (program, "_compile")):
        monkeypatch.setattr(owner, name, lambda *_, **__: made.append(1))
    found = np.array([renderer.render(camera=camera).hits.is_hit for camera in renderer.turntable(8)])
    assert made == []
    # The whole mesh is seen all the way.
    assert found.any(axis=0)[1:-1, 1:-1].mean() > 0.3
    assert not found[:, [0, -1]].any()
    assert not found[:, :, [0, -1]].any()
    for count in (0, 2.5, True, None):
        with pytest.raises(SceneError, match="at least one camera"):
            renderer.turntable(count)


def test_timings_are_those_of_the_picture_alone(renderer):
    picture, once = renderer.render(), clbvh.render(KNOT, VIEW)
    phases = ["load", "cache", "build", "open", "layout", "compile", "upload", "kernel", "download", "other", "total"]
    assert list(picture.timings) == list(renderer.timings) == list(once.timings) == phases
    assert picture.timings["kernel"] > 0
    assert picture.timings["build"] == picture.timings["load"] == picture.timings["compile"] == 0


@pytest.mark.parametrize("options", [{"layout": "bvh2"}, {"layout": "bvh8"}, {"builder": "brute"}], ids=str)
def test_a_lens_sees_what_its_rays_hit(lens_camera, options, open_tracer):
    with Renderer(KNOT, VIEW, options=RenderOptions(validate=True, **options)) as renderer:
        picture = renderer.render(camera=lens_camera)
        assert picture.rgb.shape == (60, 80, 3)
        assert renderer.render(camera=lens_camera, height=30).rgb.shape == (30, 40, 3)
    traced = open_tracer(KNOT).closest_hit(*lens_camera.rays())
    assert 0.1 < traced.is_hit.mean() < 0.9
    same = traced.prim_id == picture.hits.prim_id
    # The kernel makes its rays in float32: at an edge the neighbour may be hit.
    assert same.mean() > 0.995
    assert (traced.t[same] == picture.hits.t[same]).all()


def test_a_part_of_a_picture_is_a_lens_off_centre(renderer, lens_camera):
    whole = renderer.render(camera=lens_camera)
    left, top, width, height = 33, 7, 25, 40
    moved = K - [[0, 0, left], [0, 0, top], [0, 0, 0]]
    part = Camera.from_intrinsics(moved, lens_camera.camera_to_world(), (width, height))
    hits = renderer.render(camera=part).hits
    inside = np.s_[top : top + height, left : left + width]
    same = hits.prim_id == whole.hits.prim_id[inside]
    assert same.mean() > 0.995
    assert hits.count > 100
    np.testing.assert_allclose(hits.t[same], whole.hits.t[inside][same], rtol=1e-12)


def test_depth_is_along_the_optical_axis(lens_camera):
    # A wall across the optical axis, at depth 3, and one behind it.
    right, up, forward = lens_camera.axes()
    corners = [lens_camera.eye + 3 * forward + x * right + y * up for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
    vertices, faces = np.array([*corners, *(corner + forward for corner in corners)]), np.array([[0, 1, 2], [0, 2, 3]])
    picture = clbvh.render((vertices, np.vstack((faces, faces + 4))), camera=lens_camera, shading="depth")
    np.testing.assert_allclose(picture.depth, 3, rtol=1e-12)
    assert picture.hits.t.max() > 3.2
    assert np.ptp(picture.rgb) <= 1  # one shade of grey
    assert 20 < picture.rgb[0, 0, 0] < 240


def test_no_lens_is_too_wide_or_too_long(renderer, lens_camera):
    for focal in (1e-6, 1e-2, 1e4, 1e9):
        k = [[focal, 0, 40], [0, focal, 30], [0, 0, 1]]
        hits = renderer.render(camera=Camera.from_intrinsics(k, lens_camera.camera_to_world(), SIZE)).hits
        assert np.isfinite(hits.t[hits.is_hit]).all()


def test_all_that_is_a_mesh_is_drawn(tmp_path):
    ball, path = clbvh.make_shape("icosphere", triangles=320), tmp_path / "sphere.ply"
    solid = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    solid.export(path)
    (tmp_path / "sphere.toml").write_text('[[object]]\npath = "sphere.ply"\n')
    tree, arrays = clbvh.build(ball), (ball.vertices, ball.faces)
    for source in (ball, solid, arrays, str(path), path, tmp_path / "sphere.toml", tree, Scene(arrays), Scene(path)):
        # A PLY of trimesh is in float32.
        assert abs(clbvh.render(source, width=64, height=48, shading="normal").hits.count - 1565) < 3, source
    picture = clbvh.render(tree, options=RenderOptions(validate=True), width=16, height=9)
    assert (picture.bvh is tree, picture.workers) == (True, 0)
    assert clbvh.render("knot", width=16, height=9).rgb.shape == (9, 16, 3)


def test_what_cannot_be_drawn_is_said_before_a_fault_of_the_device(tmp_path):
    wrong = RenderOptions(device="no such device")
    sources = [None, 5, np.eye(3), [], {"mesh": 1}, b"knot", (1, 2, 3)]
    rows = [(source, MeshError, r"expected .*a clbvh\.Mesh, .*, not") for source in sources]
    rows += [(tmp_path / "missing.ply", MeshError, "no such"), (tmp_path / "missing.toml", SceneError, "no such file")]
    rows += [(KNOT, clbvh.DeviceError, "no such device"), (Scene(), SceneError, "the scene is empty")]
    for source, error, words in rows:
        with pytest.raises(error, match=words) as caught:
            Renderer(source, options=wrong if source is not rows[-1][0] else None)
        assert "\n" not in str(caught.value)


def test_a_renderer_has_the_objects_of_its_beginning():
    scene = Scene(KNOT)
    with Renderer(scene, VIEW) as renderer:
        before = renderer.render()
        scene.place(scene.geometries[0], clbvh.Transform(scale=5))
        assert same_picture(renderer.render(), before)
        assert renderer.memory_bytes > 4000 * 36
    assert renderer.is_closed
    renderer.close()
    with pytest.raises(QueryError, match="the renderer is closed"):
        renderer.render()


def test_a_failure_gives_the_devices_memory_back(monkeypatch):
    closed, close = [], DeviceSession.close
    monkeypatch.setattr(DeviceSession, "close", lambda self: closed.append(self) or close(self))

    def fail(*_, **__):
        raise SceneError("broken")

    monkeypatch.setattr(painters.Painters, "painter", fail)
    with pytest.raises(SceneError, match="broken"):
        Renderer(KNOT, VIEW)
    assert len(closed) == 1


def test_threads_share_a_renderer(renderer):
    views = [{"camera": renderer.camera.orbit(40 * number), "width": 31 + 10 * number} for number in range(6)]
    expected = [renderer.render(**view) for view in views]

    def draw_all(seed):
        for number in np.random.default_rng(seed).permutation(6):
            picture = renderer.render(**views[number])
            assert same_picture(picture, expected[number])
            assert picture.timings["kernel"] > 0

    run_in_threads(*(lambda seed=seed: draw_all(seed) for seed in range(6)))


def test_closing_waits_for_pictures_of_other_threads():
    opened = Renderer(KNOT, VIEW)
    begun, errors = threading.Event(), []

    def draw():
        try:
            while True:
                opened.render(width=200, height=150)
                begun.set()
        except QueryError as error:
            errors.append(error)

    def close():
        assert begun.wait(60)
        opened.close()

    run_in_threads(draw, draw, close)
    assert len(errors) == 2
    assert opened._session._buffers == set()

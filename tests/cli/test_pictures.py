"""What pictures show and from where, of all verbs that draw: `render`, `sheet`, `turntable` and `images`."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh
from clbvh.choices import DEFAULT_CHANNELS

from .command import run_clbvh

SIZE = ("--width", 40, "--height", 30)
VIEW = {"width": 40, "height": 30, "shading": "lambert"}
GUESS = "clbvh: z is up: the mesh stands on a wide base along z, but not along y; --up 0,1,0 turns it\n"
NOTHING = "clbvh: no ray hits anything: the picture shows the background only\n"
OUTPUTS = {"render": "a.png", "sheet": "a.png", "turntable": "a.gif", "images": "a.npz"}

# Words, and the same as arguments of the library's functions.
CHANGES = {
    "--cut 0,0,0.5;0,1,1": {"cut": clbvh.Cut.plane((0, 0, 0.5), (0, 1, 1))},
    "--cut box -1,-1,0;1,1,1": {"cut": clbvh.Cut.box((-1, -1, 0), (1, 1, 1))},
    "--wireframe": {"wireframe": clbvh.Wireframe()},
    "--wireframe-width 2": {"wireframe": clbvh.Wireframe(2.0)},
    "--up 0,1,0": {"up": (0, 1, 0)},
    "--background 1,0,0": {"background": (1, 0, 0)},
    "--shading normal --eye 3,3,3 --look-at 0,0,0": {"shading": "normal", "eye": (3, 3, 3), "look_at": (0, 0, 0)},
    "--projection orthographic:9": {"projection": "orthographic:9"},
}


@pytest.fixture
def cone(tmp_path):
    trimesh.creation.cone(1, 2, sections=16).export(tmp_path / "cone.ply")
    return tmp_path / "cone.ply"


@pytest.fixture
def scene(cone):
    path = cone.with_name("scene.toml")
    path.write_text('[[object]]\npath = "cone.ply"\n[view]\nup = "z"\neye = [4, 2, 3]\nwidth = 50\nheight = 30\n')
    return path


def read(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def run(verb, source, *words, note=""):
    """Run a verb, whose picture is small, and return it, or all channels."""
    turns = ("--frames", 2) if verb == "turntable" else ()
    path = source.with_name(OUTPUTS[verb])
    shading = () if "--shading" in words else ("--shading", "lambert")
    answer = run_clbvh(verb, source, "-o", path, *SIZE, *turns, *shading, *words)
    assert (answer.returncode, answer.stderr) == (0, note)
    return dict(np.load(path)) if verb == "images" else read(path)


def test_options_are_those_of_the_library(scene):
    plain = clbvh.render(scene, **VIEW)
    np.testing.assert_array_equal(run("render", scene), plain.rgb)
    for words, changes in CHANGES.items():
        # What is said first comes before the eye of the file.
        with clbvh.Renderer(scene) as renderer:
            expected = renderer.render(**(VIEW | changes))
        split = words.split(maxsplit=1) if "box" in words else words.split()
        note = "" if expected.hits.count else NOTHING
        np.testing.assert_array_equal(run("render", scene, *split, note=note), expected.rgb, err_msg=words)
        assert (expected.rgb != plain.rgb).any(), words


def test_an_environment_asks_for_the_shading_that_sees_it_unless_another_one_is_given(scene, tmp_path):
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
    (tmp_path / "sky.hdr").write_bytes(head + 32 * bytes([128, 0, 0, 129]))
    words = ("render", scene, "-o", tmp_path / "a.png", *SIZE, "--environment", tmp_path / "sky.hdr", "--samples", 1)
    for given, shading in (((), "path"), (("--shading", "lambert"), "lambert")):
        assert run_clbvh(*words, *given).returncode == 0
        changes = {"shading": shading, "environment": tmp_path / "sky.hdr", "samples": 1}
        np.testing.assert_array_equal(read(tmp_path / "a.png"), clbvh.render(scene, **(VIEW | changes)).rgb)


class TestUp:
    def test_a_guess_is_said_and_may_be_overruled(self, cone):
        for verb in OUTPUTS:
            run(verb, cone, note=GUESS)
            run(verb, cone, "--json", note=GUESS)
            run(verb, cone, "--up", "0,0,1")

    def test_a_guess_is_made_of_all_files_but_not_against_what_is_known(self, cone, scene):
        trimesh.load(cone).export(cone.with_name("cone.glb"))
        run("render", cone.with_name("cone.glb"))
        run("render", cone, cone, note=GUESS)
        scene.write_text(scene.read_text().replace('up = "z"\neye = [4, 2, 3]', ""))
        run("render", scene, note=GUESS)
        run("render", cone, "--eye", "0,0,9", "--look-at", "0,0,0")


def test_a_sheet_and_its_reports(scene, tmp_path):
    words = ("sheet", scene, "-o", tmp_path / "a.png", "-o", tmp_path / "a.ppm", *SIZE, "--shading", "lambert")
    answer = run_clbvh(*words)
    assert (answer.returncode, answer.stderr) == (0, "")
    expected = clbvh.contact_sheet(scene, **VIEW).rgb
    np.testing.assert_array_equal(read(tmp_path / "a.png"), expected)
    np.testing.assert_array_equal(read(tmp_path / "a.ppm"), expected)
    assert f"a.png: 7 views, 160 x {len(expected)}" in answer.stdout
    report = json.loads(run_clbvh(*words, "--json").stdout)
    assert report["views"] == ["front", "right", "back", "left", "top", "bottom", "iso"]
    assert (report["width"], report["pixel_size"] > 0) == (160, True)


def test_a_turntable_and_its_reports(scene, tmp_path):
    words = ("--frames", 3, "--width", 40, "--shading", "lambert")
    answer = run_clbvh("turntable", scene, "-o", tmp_path / "a.gif", *words, "--fps", 10)
    assert (answer.returncode, answer.stderr) == (0, "")
    with Image.open(tmp_path / "a.gif") as image:
        # The height is the scene's.
        assert (image.n_frames, image.size, image.info["duration"]) == (3, (40, 30), 100)
    assert "3 frames of 40 x 30, 0.3 s" in answer.stdout
    report = json.loads(run_clbvh("turntable", scene, "-o", tmp_path / "a.mp4", *words, "--json").stdout)
    assert report["bytes"] == (tmp_path / "a.mp4").stat().st_size > 0
    assert (report["frames"], report["frames_per_s"], report["width"], report["height"]) == (3, 25.0, 40, 30)


class TestImages:
    def test_files_of_all_kinds_and_their_reports(self, scene, tmp_path):
        files = [part for name in ("a.npz", "a.exr", "a.png") for part in ("-o", tmp_path / name)]
        words = ("images", scene, *files, *SIZE, "--shading", "lambert", "--depth-scale", 1000)
        answer = run_clbvh(*words)
        assert (answer.returncode, answer.stderr) == (0, "")
        with np.load(tmp_path / "a.npz") as loaded:
            assert {*DEFAULT_CHANNELS, "camera_to_world", "intrinsics"} <= set(loaded)
            depth = loaded["depth"]
        assert depth.shape == (30, 40)
        assert f"{depth[np.isfinite(depth)].min():,.6g}" in answer.stdout
        assert "40 x 30" in answer.stdout
        assert (tmp_path / "a.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
        assert json.loads((tmp_path / "a.json").read_text())["channels"]["depth"]["scale"] == 1000
        assert all((tmp_path / f"a-{name}.png").is_file() for name in DEFAULT_CHANNELS)
        assert tuple(json.loads(run_clbvh(*words, "--json").stdout)["channels"]) == DEFAULT_CHANNELS

    def test_a_camera_comes_back_from_its_file_and_shows_the_same(self, scene, tmp_path):
        view = ("--eye", "1,2,4", "--look-at", "0,0,0", "--fov", 30)
        assert run_clbvh("images", scene, "-o", tmp_path / "a.png", "-o", tmp_path / "a.npz", *SIZE, *view).stderr == ""
        camera = tmp_path / "a.json"
        wanted = ("--channels", "depth,motion", "--camera-file", camera, "--next-camera-file", camera)
        assert run_clbvh("images", scene, "-o", tmp_path / "b.npz", *wanted).returncode == 0
        with np.load(tmp_path / "a.npz") as first, np.load(tmp_path / "b.npz") as again:
            np.testing.assert_allclose(again["depth"], first["depth"], rtol=1e-6)
            assert np.abs(again["motion"][np.isfinite(again["depth"])]).max() < 1e-6

"""What pictures show and from where: `--up`, `--frame`, `--side`, `--cut`, `--wireframe`, of all verbs that draw."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh

from .command import refuses, run_clbvh

SIZE = ("--width", 40, "--height", 30, "--shading", "lambert")
VIEW = {"width": 40, "height": 30, "shading": "lambert"}
GUESS = "clbvh: z is up: the mesh stands on a wide base along z, but not along y; --up 0,1,0 turns it\n"
NOTHING = "clbvh: no ray hits anything: the picture shows the background only\n"
OUTPUTS = {"render": "a.png", "sheet": "a.png", "turntable": "a.gif", "images": "a.npz"}
ONLY_TURNS = ("--frames", 2)


@pytest.fixture
def cone(tmp_path):
    trimesh.creation.cone(1, 2, sections=16).export(tmp_path / "cone.ply")
    return tmp_path / "cone.ply"


@pytest.fixture
def ball(tmp_path):
    """A ball, and a triangle far away."""
    solid = trimesh.creation.icosphere(3)
    corners = [[900, 0, 0], [900, 0.1, 0], [900, 0, 0.1]]
    faces = np.arange(3)[None] + len(solid.vertices)
    vertices = np.concatenate((solid.vertices, corners))
    trimesh.Trimesh(vertices, np.concatenate((solid.faces, faces)), process=False).export(tmp_path / "ball.obj")
    return tmp_path / "ball.obj"


def read(path):
    with Image.open(path) as image:
        return np.asarray(image)


def run(verb, source, folder, *words):
    turns = ONLY_TURNS if verb == "turntable" else ()
    return run_clbvh(verb, source, "-o", folder / OUTPUTS[verb], *SIZE, *turns, *words)


def test_a_picture_of_nothing_says_so(tmp_path):
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n")
    answer = run("render", tmp_path / "line.obj", tmp_path, "--up", "z")
    assert (answer.returncode, answer.stderr) == (0, NOTHING)
    assert "1 triangle, 1 of them degenerate" in answer.stdout


@pytest.mark.parametrize("verb", OUTPUTS)
def test_a_guess_is_said_and_may_be_overruled(verb, cone, tmp_path):
    answer = run(verb, cone, tmp_path)
    assert (answer.returncode, answer.stderr) == (0, GUESS)
    answer = run(verb, cone, tmp_path, "--up", "0,0,1")
    assert (answer.returncode, answer.stderr) == (0, "")


def test_the_guess_decides_the_picture(cone, tmp_path):
    for words, up in (((), (0, 0, 1)), (("--up", "auto"), (0, 0, 1)), (("--up", "0,1,0"), (0, 1, 0))):
        assert run("render", cone, tmp_path, *words).returncode == 0
        expected = clbvh.render(clbvh.load_mesh(cone), up=up, **VIEW)
        np.testing.assert_array_equal(read(tmp_path / "a.png"), expected.rgb)
    assert clbvh.render(cone, **VIEW).notes[0] in GUESS


def test_gltf_files_and_scenes_with_an_up_are_not_guessed(cone, tmp_path):
    trimesh.load(cone).export(tmp_path / "cone.glb")
    (tmp_path / "a.toml").write_text('[[object]]\npath = "cone.ply"\n[view]\nup = [0, 0, 1]\n')
    (tmp_path / "b.toml").write_text('[[object]]\npath = "cone.ply"\n')
    for name, note in {"cone.glb": "", "a.toml": "", "b.toml": GUESS}.items():
        answer = run("render", tmp_path / name, tmp_path)
        assert (answer.returncode, answer.stderr) == (0, note)


def test_several_files_are_guessed_together(cone, tmp_path):
    answer = run_clbvh("render", cone, cone, "-o", tmp_path / "a.png", *SIZE)
    assert (answer.returncode, answer.stderr) == (0, GUESS)


def test_a_camera_may_look_along_the_guess(cone, tmp_path):
    answer = run("render", cone, tmp_path, "--eye", "0,0,9", "--look-at", "0,0,0")
    assert (answer.returncode, answer.stderr) == (0, "")


@pytest.mark.parametrize("verb", OUTPUTS)
def test_what_is_left_out_of_the_frame_is_said(verb, ball, tmp_path):
    answer = run(verb, ball, tmp_path)
    assert answer.returncode == 0
    assert answer.stderr.startswith("clbvh: 1 of 1,281 triangles (0.078 %) is far away from the others")
    assert answer.stderr.endswith("; --frame all shows everything\n")
    answer = run(verb, ball, tmp_path, "--frame", "all")
    assert (answer.returncode, answer.stderr) == (0, NOTHING if verb == "render" else "")


WIREFRAMES = {
    ("--wireframe",): clbvh.Wireframe(),
    ("--wireframe-width", "2"): clbvh.Wireframe(2.0),
    ("--wireframe", "--wireframe-colour", "1,0,0"): clbvh.Wireframe(colour=(1, 0, 0)),
}


@pytest.mark.parametrize("words", WIREFRAMES)
def test_wireframes(words, cone, tmp_path):
    assert run("render", cone, tmp_path, *words).returncode == 0
    expected = clbvh.render(cone, wireframe=WIREFRAMES[words], **VIEW)
    np.testing.assert_array_equal(read(tmp_path / "a.png"), expected.rgb)
    assert (expected.rgb != clbvh.render(cone, **VIEW).rgb).any()


@pytest.mark.parametrize("verb", ["sheet", "turntable", "images"])
def test_other_verbs_have_wireframes(verb, cone, tmp_path):
    found = []
    for words in ((), ("--wireframe",)):
        assert run(verb, cone, tmp_path, *words).returncode == 0
        path = tmp_path / OUTPUTS[verb]
        found.append(np.load(path)["rgb"] if verb == "images" else read(path))
    assert (found[0] != found[1]).any()


def test_images_have_views_and_cuts(cone, tmp_path):
    answer = run("images", cone, tmp_path, "--side", "top", "--cut", "0,0,0.2;0,0,1", "--channels", "range,position")
    assert answer.returncode == 0
    cut = clbvh.Cut.plane((0, 0, 0.2), (0, 0, 1))
    expected = clbvh.render_images(cone, ("range", "position"), side="top", cut=cut, **VIEW)
    with np.load(tmp_path / "a.npz") as loaded:
        np.testing.assert_array_equal(loaded["range"], expected["range"])
        assert np.nanmax(loaded["position"][..., 2]) <= 0.2 + 1e-6
    assert run("images", cone, tmp_path, "--cut", "box -9,-9,-9;9,9,9", "--channels", "range").returncode == 0
    assert np.isinf(np.load(tmp_path / "a.npz")["range"]).all()


@pytest.mark.parametrize(
    ("verb", "words", "said"),
    [
        ("render", ("--up", "w"), "up must be a direction, an axis"),
        ("render", ("--frame", "bulk"), "auto, all"),
        ("render", ("--wireframe-width", 0), "above 0"),
        ("render", ("--wireframe-colour", "red"), "three finite numbers"),
        ("render", ("--wireframe-colour", "2,0,0"), "wireframe_colour must be"),
        ("images", ("--side", "nowhere"), "front"),
        ("images", ("--camera-file", "camera.json", "--side", "top"), "--camera-file says all"),
        ("images", ("--side", "top", "--eye", "1,2,3"), "side"),
    ],
)
def test_wrong_words_are_one_line(verb, words, said, cone, tmp_path):
    refuses(run(verb, cone, tmp_path, *words), 2, said)

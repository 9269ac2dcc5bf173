"""`clbvh turntable`: files written, messages, exit codes."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from .command import refuses, run_clbvh

WORDS = ("--frames", 3, "--width", 40, "--height", 30, "--shading", "lambert")


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[object]]\nshape = "icosphere"\ntriangles = 80\n[view]\nwidth = 50\n')
    return path


def test_a_gif_and_a_line_about_it(scene, tmp_path):
    answer = run_clbvh("turntable", scene, "-o", tmp_path / "a.gif", *WORDS, "--fps", 10)
    assert answer.returncode == 0, answer.stderr
    with Image.open(tmp_path / "a.gif") as image:
        assert (image.n_frames, image.size, image.info["duration"]) == (3, (40, 30), 100)
    assert "3 frames of 40 x 30, 0.3 s" in answer.stdout
    assert answer.stderr == ""


def test_a_video_and_json(scene, tmp_path):
    answer = run_clbvh("turntable", scene, "-o", tmp_path / "a.mp4", *WORDS, "--json")
    assert answer.returncode == 0, answer.stderr
    report = json.loads(answer.stdout)
    assert report["bytes"] == (tmp_path / "a.mp4").stat().st_size > 0
    assert (report["frames"], report["frames_per_s"], report["width"], report["height"]) == (3, 25.0, 40, 30)


def test_the_scene_s_own_settings_hold(scene, tmp_path):
    answer = run_clbvh("turntable", scene, "-o", tmp_path / "a.gif", "--frames", 1, "--json", "--height", 20)
    assert (json.loads(answer.stdout)["width"], json.loads(answer.stdout)["height"]) == (50, 20)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "a.avi"), ".gif or .mp4"),
        (("-o", "a.gif", "--frames", 0), "from 1 to"),
        (("-o", "a.gif", "--fps", 0), "frames_per_s"),
        (("-o", "a.gif", "--fps", "nan"), "frames_per_s"),
        (("-o", "a.gif", "--projection", "panorama"), "panorama"),
        (("-o", "a.gif", "--up", "0,1"), "up must be"),
    ],
)
def test_wrong_input_is_refused(scene, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    refuses(run_clbvh("turntable", scene, *words), 2, said)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]

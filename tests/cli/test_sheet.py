"""`clbvh sheet`, and `--side` of `clbvh render`: files written, messages, exit codes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import clbvh

from .command import refuses, run_clbvh

SIZE = ("--width", 40, "--height", 30, "--shading", "lambert")


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[object]]\nshape = "icosphere"\ntriangles = 80\n[view]\neye = [1, 2, 3]\n')
    return path


def read(path):
    with Image.open(path) as image:
        return np.asarray(image)


def test_a_sheet_and_a_line_about_it(scene, tmp_path):
    answer = run_clbvh("sheet", scene, "-o", tmp_path / "a.png", "-o", tmp_path / "a.ppm", *SIZE)
    assert (answer.returncode, answer.stderr) == (0, "")
    expected = clbvh.contact_sheet(scene, width=40, height=30, shading="lambert").rgb
    np.testing.assert_array_equal(read(tmp_path / "a.png"), expected)
    np.testing.assert_array_equal(read(tmp_path / "a.ppm"), expected)
    assert f"a.png: 7 views, 160 x {len(expected)}" in answer.stdout


def test_json(scene, tmp_path):
    answer = run_clbvh("sheet", scene, "-o", tmp_path / "a.png", *SIZE, "--json")
    report = json.loads(answer.stdout)
    assert report["views"] == ["front", "right", "back", "left", "top", "bottom", "iso"]
    assert report["width"] == 160
    assert report["pixel_size"] > 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "a.gif"), ".png, .jpg, .jpeg, .ppm"),
        (("-o", "a.png", "--width", 0), "width"),
        (("-o", "a.png", "--up", "0,0,0"), "up"),
        (("-o", "a.png", "--shading", "nice"), "shading"),
    ],
)
def test_wrong_input_is_refused(scene, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    refuses(run_clbvh("sheet", scene, *words), 2, said)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_a_view_takes_the_place_of_the_file_s_eye(scene, tmp_path):
    answer = run_clbvh("render", scene, "-o", tmp_path / "a.png", "--side", "top", *SIZE)
    assert answer.returncode == 0, answer.stderr
    with clbvh.Renderer(scene) as renderer:
        expected = renderer.render(side="top", width=40, height=30, shading="lambert").rgb
    np.testing.assert_array_equal(read(tmp_path / "a.png"), expected)


@pytest.mark.parametrize(
    ("words", "said"), [(("--side", "above"), "side"), (("--side", "top", "--eye", "1,2,3"), "'top'")]
)
def test_wrong_views_are_refused(scene, tmp_path, words, said):
    refuses(run_clbvh("render", scene, "-o", tmp_path / "a.png", *words), 2, said)

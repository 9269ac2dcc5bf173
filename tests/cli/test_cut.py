"""`--cut`: pictures, messages, exit codes."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import clbvh

from .command import refuses, run_clbvh

SIZE = ("--width", 40, "--height", 30, "--shading", "lambert")
CUTS = {
    ("--cut", "0,0,0;0,1,1"): clbvh.Cut.plane((0, 0, 0), (0, 1, 1)),
    ("--cut", "box -1,-1,0;1,1,2"): clbvh.Cut.box((-1, -1, 0), (1, 1, 2)),
    ("--cut", "z=50%"): "z=50%",
}


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[object]]\nshape = "icosphere"\ntriangles = 80\n')
    return path


@pytest.mark.parametrize("words", CUTS)
def test_pictures_and_hits_are_cut(scene, tmp_path, words):
    files = ("-o", tmp_path / "a.png", "--hits", tmp_path / "a.npz")
    answer = run_clbvh("render", scene, *files, *words, *SIZE, "--validate")
    assert (answer.returncode, answer.stderr) == (0, "")
    expected = clbvh.render(scene, cut=CUTS[words], width=40, height=30, shading="lambert")
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), expected.rgb)
    with np.load(tmp_path / "a.npz") as hits:
        np.testing.assert_array_equal(hits["t"], expected.hits.t)
    assert expected.hits.count > 0


def test_sheets_and_turntables_are_cut(scene, tmp_path):
    everything = ("--cut", "0,-9,0;0,1,0", "--background", "0,0,0", "--width", 30, "--height", 20, "--ground")
    answer = run_clbvh("sheet", scene, "-o", tmp_path / "a.png", *everything, "--shading", "lambert")
    assert answer.returncode == 0, answer.stderr
    with Image.open(tmp_path / "a.png") as image:
        assert not np.asarray(image)[:20, :30].any()
    answer = run_clbvh("turntable", scene, "-o", tmp_path / "a.gif", "--frames", 2, *everything, "--shading", "lambert")
    assert answer.returncode == 0, answer.stderr
    with Image.open(tmp_path / "a.gif") as image:
        assert not np.asarray(image.convert("RGB")).any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--cut", "0,0,0"), "a cut is a text such as"),
        (("--cut", "0,0,0;0,0,0"), "length above 0"),
        (("--cut", "box 0,0,1;1,1,0"), "lower corner"),
        (("--cut", "z=101%"), "0 to 100 %"),
    ],
)
def test_wrong_cuts_are_refused(scene, tmp_path, words, said):
    refuses(run_clbvh("render", scene, "-o", tmp_path / "a.png", *words), 2, said)
    assert not (tmp_path / "a.png").exists()

"""The examples as scripts: their output and the files they write are right."""

import re
import runpy
import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def run(session, tmp_path, monkeypatch, capsys):
    """A function from an example and its arguments to its output; it runs in an empty folder."""

    def run_example(name, *arguments):
        path = str(EXAMPLES / f"{name}.py")
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [path, *arguments])
        runpy.run_path(path, run_name="__main__")
        return capsys.readouterr().out

    return run_example


@pytest.fixture
def sphere(tmp_path):
    path = tmp_path / "sphere.ply"
    trimesh.creation.icosphere(3).export(path)
    return str(path)


def test_every_example_is_tested():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {"ambient_occlusion", "depth_map", "inside_test"}


def test_ambient_occlusion_of_a_sphere_is_open_sky(run, sphere, tmp_path):
    assert "100% of the sky, from 100% to 100%" in run("ambient_occlusion", sphere, "--rays", "4")
    written = trimesh.load(tmp_path / "occlusion.ply", process=False)
    assert (written.visual.vertex_colors == 255).all()


def test_ambient_occlusion_of_the_knot_is_dark_in_places(run, tmp_path):
    text = run("ambient_occlusion", "--rays", "8", "-o", "dark.ply")
    mean, least, most = map(int, re.search(r"see (\d+)% of the sky, from (\d+)% to (\d+)%", text).groups())
    assert least < 30 < mean < most == 100
    assert (tmp_path / "dark.ply").is_file()


def test_depth_map_of_a_sphere(run, sphere, tmp_path):
    text = run("depth_map", sphere, "--width", "65")
    assert "device=" in text
    near, far = map(float, re.search(r"from (\S+) to ([\d.e+-]+),", text).groups())
    assert near == pytest.approx(4, abs=0.01)
    assert 4.5 < far <= 5.01
    picture = imageio.imread(tmp_path / "depth.png")
    assert picture.shape == (65, 65)
    assert picture[32, 32] == picture.max()
    assert picture[0, 0] == 0
    assert np.count_nonzero(picture) / picture.size == pytest.approx(np.pi / 4, rel=0.1)


def test_inside_test_finds_the_volume(run, sphere):
    text = run("inside_test", sphere, "--points", "20000")
    estimate, error, exact = map(float, re.search(r"points: (\S+) \+- (\S+), by its faces: (\S+)", text).groups())
    assert abs(estimate - exact) < 5 * error
    assert exact == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert float(text.split(":")[-1]) == pytest.approx(1, rel=0.02)
    assert "volume" in run("inside_test", "--points", "1000")

"""`clbvh study`: the list, refusals, a tiny study, Ctrl-C, and the heat map of `clbvh render`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh.study import run, scale
from clbvh.study.experiments import EXPERIMENTS

from .command import TIMEOUT_S, make_environment, refuses, run_clbvh, run_process

SCENE = '[[object]]\nshape = "knot"\ntriangles = 1000\n[view]\nup = "y"\nwidth = 60\nheight = 30\n'

# The command with a tiny study in place of the quick one. Where the tests run in the background, their children ignore
# Ctrl-C unless told so.
TINY = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import clbvh.study.scale as s
s.QUICK = s.TINY
from clbvh.cli import main
main()
"""


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(scale, "QUICK", scale.TINY)


def test_list_names_every_experiment():
    answer = run_clbvh("study", "--list")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert [line.split()[0] for line in answer.stdout.splitlines()] == list(EXPERIMENTS)


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from clbvh.cli.app import run\n"
        "try: run(['study', '--help'])\nexcept SystemExit: pass\n"
        "assert not {'numba', 'numpy', 'pyopencl', 'matplotlib'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=TIMEOUT_S, capture_output=True)


def test_an_unknown_experiment_is_refused(tmp_path):
    refuses(run_clbvh("study", "ladders", "-o", tmp_path), 2, "'ladders'", "ladder")


def test_a_page_without_samples_is_refused(tmp_path):
    refuses(run_clbvh("study", "--page", "-o", tmp_path), 2, "no samples")


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    path = tmp_path / "file"
    path.touch()
    refuses(run_clbvh("study", "-o", path), 2, "this folder cannot be created")


@pytest.mark.usefixtures("tiny", "_opened_device")
def test_one_experiment(tmp_path):
    answer = run_clbvh("study", "threshold", "--quick", "-o", tmp_path)
    assert answer.returncode == 0, answer.stderr
    files = answer.stdout.splitlines()
    assert files == [str(tmp_path / name) for name in ("index.html", "samples.jsonl", "samples.csv")]
    page = (tmp_path / "index.html").read_text()
    assert '<section id="threshold">' in page
    assert '<section id="ladder">' not in page
    # Another experiment joins it.
    assert run_clbvh("study", "divergence", "--quick", "-o", tmp_path).returncode == 0
    page = (tmp_path / "index.html").read_text()
    assert page.index('<section id="threshold">') < page.index('<section id="divergence">')


def test_a_study_without_matplotlib_is_refused_before_it_measures(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "_PACKAGES", ("no-such-package", "Jinja2"))
    refuses(run_clbvh("study", "threshold", "--quick", "-o", tmp_path / "study"), 2, "pip install no-such-package")
    assert not (tmp_path / "study").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is another event there")
def test_ctrl_c_keeps_the_samples_and_the_next_run_goes_on(tmp_path):
    command = [sys.executable, "-c", TINY, "study", "ladder", "scaling", "--quick", "-o", str(tmp_path)]
    samples = tmp_path / "samples.jsonl"
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=make_environment(), start_new_session=True)  # fmt: skip
    deadline = time.monotonic() + TIMEOUT_S
    while not (samples.is_file() and samples.read_bytes().count(b"\n") >= 3) and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1].endswith("clbvh: interrupted")
    kept = samples.read_bytes()
    assert kept.count(b"\n") >= 3
    assert not (tmp_path / "index.html").exists()
    again = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, env=make_environment())
    assert again.returncode == 0, again.stderr
    assert samples.read_bytes().startswith(kept[: kept.rindex(b"\n") + 1])
    assert (tmp_path / "index.html").is_file()


@pytest.mark.usefixtures("_opened_device")
@pytest.mark.parametrize("quantity", ["nodes", "triangles"])
def test_heat_map_of_a_scene(tmp_path, quantity):
    scene, out = tmp_path / "knot.toml", tmp_path / "out.png"
    scene.write_text(SCENE)
    answer = run_clbvh("render", scene, "-o", out, "--heatmap", quantity)
    assert answer.returncode == 0, answer.stderr
    picture = imageio.imread(out)
    assert picture.shape[1] == 60
    assert picture.shape[0] > 30
    # The corner of the picture sees nothing, its middle the mesh.
    assert int(picture[15, 30].sum()) > int(picture[0, 0].sum())
    assert len(np.unique(picture[:30].reshape(-1, 3), axis=0)) > 10


def test_refused_heat_maps(tmp_path):
    scene, out = tmp_path / "knot.toml", tmp_path / "out.png"
    scene.write_text(SCENE)
    refuses(run_clbvh("render", scene, "-o", out, "--heatmap", "boxes"), 2, "nodes, triangles", "'boxes'")
    refuses(run_clbvh("render", scene, "-o", out, "--heatmap", "nodes", "--builder", "brute"), 2, "brute")


def test_no_device_is_no_crash(tmp_path):
    refuses(run_process("study", "--device", "9999", "-o", tmp_path), 3, "9999")

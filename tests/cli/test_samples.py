"""`clbvh render` with samples: limits of time, bands, transparency, and what a terminal shows."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from clbvh.rendering import painters

from .command import make_environment, refuses, run_clbvh

SIZE = ("--width", 40, "--height", 30)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[[object]]\nshape = "icosphere"\ntriangles = 80\n')
    return path


@pytest.mark.parametrize("more", [(), ("--samples", 1_000_000)])
def test_a_short_time_takes_one_sample_at_least(scene, tmp_path, more):
    answer = run_clbvh("render", scene, "-o", tmp_path / "a.png", *SIZE, "--time", 0.01, "--json", *more)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert 1 <= json.loads(answer.stdout)["samples"] < 1_000_000
    assert (tmp_path / "a.png").is_file()


@pytest.mark.parametrize("time", ["0", "-1", "nan"])
def test_wrong_times_are_refused(scene, tmp_path, time):
    refuses(run_clbvh("render", scene, "-o", tmp_path / "a.png", "--time", time), 2, "time limit")


@pytest.mark.parametrize("shading", ["studio", "ao"])
def test_bands_do_not_change_the_file(scene, tmp_path, monkeypatch, shading):
    words = ("render", scene, *SIZE, "--samples", 5, "--shading", shading, "--transparent")
    assert run_clbvh(*words, "-o", tmp_path / "whole.png").returncode == 0
    monkeypatch.setattr(painters, "BAND_PIXELS", 40 * 7)
    assert run_clbvh(*words, "-o", tmp_path / "bands.png").returncode == 0
    assert (tmp_path / "whole.png").read_bytes() == (tmp_path / "bands.png").read_bytes()


def test_a_transparent_png_has_alpha(scene, tmp_path):
    answer = run_clbvh("render", scene, "-o", tmp_path / "a.png", *SIZE, "--samples", 4, "--transparent", "--no-ground")
    assert answer.returncode == 0, answer.stderr
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGBA"
        alpha = np.asarray(image)[..., 3]
    assert (alpha[0, 0], alpha[15, 20]) == (0, 255)
    assert ((alpha > 0) & (alpha < 255)).any()


def test_a_transparent_ppm_is_refused_before_any_work(scene, tmp_path, monkeypatch):
    fail = lambda *_, **__: pytest.fail("no work before the check")  # noqa: E731
    words = ("render", scene, "-o", tmp_path / "a.ppm", *SIZE, "--samples", 1)
    with monkeypatch.context() as patch:
        patch.setattr("clbvh.rendering.renderer.render", fail)
        refuses(run_clbvh(*words, "--transparent"), 2, ".png")
        scene.write_text(f"{scene.read_text()}\n[view]\ntransparent = true\n")
        refuses(run_clbvh(*words), 2, ".png")
        assert not (tmp_path / "a.ppm").exists()
    assert run_clbvh(*words, "--no-transparent").returncode == 0


def test_a_terminal_shows_the_progress(scene, tmp_path):
    main, terminal = pty.openpty()
    words = ["render", scene, "-o", tmp_path / "a.png", *SIZE, "--time", 2]
    process = subprocess.Popen(
        [sys.executable, "-c", "from clbvh.cli import main; main()", *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=terminal,
        env=make_environment(TERM="xterm"),
    )
    os.close(terminal)
    shown = b""
    while True:
        try:
            part = os.read(main, 4096)
        except OSError:  # Linux's end of a terminal
            break
        if not part:
            break
        shown += part
    os.close(main)
    assert process.wait() == 0
    assert b"open the device ..." in shown
    assert b"of 2 s" in shown

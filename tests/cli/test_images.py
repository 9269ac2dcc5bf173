"""`clbvh images`: files written, messages, exit codes."""

from __future__ import annotations

import json

import numpy as np
import pytest

import clbvh
from clbvh.choices import DEFAULT_CHANNELS
from clbvh.rendering import channels
from clbvh.rendering.images import Images

from .command import refuses, run_clbvh

SIZE = ("--width", 40, "--height", 30, "--shading", "lambert")


@pytest.fixture
def mesh(tmp_path):
    ball = clbvh.make_shape("icosphere", triangles=320)
    path = tmp_path / "ball.off"
    rows = [f"{x!r} {y!r} {z!r}" for x, y, z in ball.vertices.tolist()]
    faces = [f"3 {a} {b} {c}" for a, b, c in ball.faces.tolist()]
    path.write_text("\n".join(["OFF", f"{len(rows)} {len(faces)} 0", *rows, *faces, ""]))
    return path


def test_one_file_has_all_channels(mesh, tmp_path):
    answer = run_clbvh("images", mesh, "-o", tmp_path / "a.npz", "--channels", "depth, normal,primitive_id", *SIZE)
    assert answer.returncode == 0, answer.stderr
    with np.load(tmp_path / "a.npz") as loaded:
        assert {"depth", "normal", "primitive_id", "camera_to_world", "intrinsics"} <= set(loaded)
        assert loaded["depth"].shape == (30, 40)
        depth = loaded["depth"][np.isfinite(loaded["depth"])]
    assert f"{depth.min():,.6g}" in answer.stdout
    assert "40 x 30" in answer.stdout


def test_png_files_and_json(mesh, tmp_path):
    answer = run_clbvh("images", mesh, "-o", tmp_path / "a.png", "--depth-scale", 1000, "--json", *SIZE)
    assert answer.returncode == 0, answer.stderr
    report = json.loads(answer.stdout)
    assert tuple(report["channels"]) == DEFAULT_CHANNELS
    facts = json.loads((tmp_path / "a.json").read_text())
    assert facts["channels"]["depth"]["scale"] == 1000
    for name in DEFAULT_CHANNELS:
        assert (tmp_path / f"a-{name}.png").is_file()


def test_exr_file(mesh, tmp_path):
    pytest.importorskip("OpenEXR")
    answer = run_clbvh("images", mesh, "-o", tmp_path / "a.exr", "-o", tmp_path / "a.npz", *SIZE)
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "a.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_a_camera_comes_back_from_its_file_and_shows_the_same(mesh, tmp_path):
    view = ("--eye", "1,2,4", "--look-at", "0,0,0", "--fov", 30)
    assert run_clbvh("images", mesh, "-o", tmp_path / "a.png", "-o", tmp_path / "a.npz", *SIZE, *view).returncode == 0
    camera = tmp_path / "a.json"
    wanted = ("--channels", "depth,motion", "--camera-file", camera, "--next-camera-file", camera)
    answer = run_clbvh("images", mesh, "-o", tmp_path / "b.npz", *wanted)
    assert answer.returncode == 0, answer.stderr
    with np.load(tmp_path / "a.npz") as first, np.load(tmp_path / "b.npz") as again:
        np.testing.assert_allclose(again["depth"], first["depth"], rtol=1e-6)
        seen = np.isfinite(again["depth"])
        assert np.abs(again["motion"][seen]).max() < 1e-6


def test_a_panorama(mesh, tmp_path):
    wanted = ("--channels", "range", "--projection", "panorama", "--eye", "0.1,0,0", "--look-at", "1,0,0")
    assert run_clbvh("images", mesh, "-o", tmp_path / "a.npz", *wanted, *SIZE).returncode == 0
    with np.load(tmp_path / "a.npz") as loaded:
        assert (loaded["range"] < 1.11).all()  # from inside the ball, in all directions


def test_more_samples_are_more_shares_of_a_pixel(mesh, tmp_path):
    wanted = ("--channels", "alpha,depth", "--shading", "studio", "--samples", 3)
    assert run_clbvh("images", mesh, "-o", tmp_path / "a.npz", *SIZE[:4], *wanted).returncode == 0
    with np.load(tmp_path / "a.npz") as loaded:
        shares = np.unique(loaded["alpha"].round(3))
        assert len(shares) > 2
        assert np.isfinite(loaded["depth"]).sum() == pytest.approx(loaded["alpha"].sum(), rel=0.1)


def test_an_empty_view_is_said(mesh, tmp_path):
    view = ("--eye", "0,0,9", "--look-at", "0,0,20")
    answer = run_clbvh("images", mesh, "-o", tmp_path / "a.npz", "--channels", "depth", *SIZE, *view)
    assert "no values" in answer.stdout


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--channels", "depth,glow"), "there is no channel 'glow'"),
        (("--channels", ","), "at least one channel"),
        (("--channels", "motion"), "--next-camera-file"),
        (("--camera-file", "gone.json", "--fov", "30"), "--camera-file says all of the view"),
        (("--projection", "fisheye", "--fov", "30"), "fov is that of a perspective camera"),
        (("--camera-file", "gone.json"), "gone.json: no such file"),
        (("--eye", "1,2"), "eye must be three"),
        (("--depth-scale", "0"), "depth_scale must be"),
    ],
)
def test_wrong_words_are_one_line(mesh, tmp_path, words, named):
    refuses(run_clbvh("images", mesh, "-o", tmp_path / "a.png", *words, *SIZE), 2, named)
    assert [path.name for path in tmp_path.iterdir()] == ["ball.off"]


def test_a_wrong_file_is_found_before_the_work(mesh, tmp_path):
    refuses(run_clbvh("images", "gone.ply", "-o", tmp_path / "a.jpg"), 2, "must end in .exr, .npz, .png, .ppm")
    refuses(run_clbvh("images", "gone.ply", "-o", tmp_path / "a.npz"), 2, "gone.ply")


def test_the_channels_of_the_help_are_those_of_the_package():
    help_text = " ".join(run_clbvh("images", "--help").stdout.replace("\u2502", " ").split())
    for name in channels.CHANNELS:
        assert name in help_text
        assert name in Images.__doc__

"""Turntables: one frame for each camera of the turn, and a file that is whole or absent."""

from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest

import clbvh
from clbvh.rendering import series as module
from clbvh.rendering.series import render_turntable

BALL = clbvh.make_shape("icosphere", triangles=80)
SIZE = {"width": 40, "height": 30}


@pytest.fixture
def frames(monkeypatch):
    """The frames that are written, and their rate."""
    written = []

    def keep(path, frames, frames_per_s):
        written.extend([frames_per_s, *frames])

    monkeypatch.setattr(module, "write_animation", keep)
    return written


def test_the_frames_are_those_of_the_cameras_of_the_turn(frames, tmp_path):
    done = []
    render_turntable(
        BALL, tmp_path / "a.gif", frames=3, frames_per_s=7, samples=2, on_frame=lambda *pair: done.append(pair), **SIZE
    )
    with clbvh.Renderer(BALL) as renderer:
        cameras = renderer.turntable(3, **SIZE)
        expected = [renderer.render(camera=camera, samples=2, **SIZE).rgb for camera in cameras]
    assert frames[0] == 7
    np.testing.assert_array_equal(frames[1:], expected)
    assert not np.array_equal(expected[0], expected[1])
    assert done == [(1, 3), (2, 3), (3, 3)]


def test_the_turn_is_about_up(frames, tmp_path):
    scene = clbvh.Scene(BALL)
    view = clbvh.View(up=(0, 1, 0), **SIZE, shading="normal")
    render_turntable(scene, tmp_path / "a.gif", view, frames=2, up=(0, 0, 1))
    with clbvh.Renderer(scene, view) as renderer:
        expected = [renderer.render(camera=camera).rgb for camera in renderer.turntable(2, up=(0, 0, 1))]
    np.testing.assert_array_equal(frames[1:], expected)


def test_a_transparent_scene_has_its_background(frames, tmp_path):
    scene = clbvh.Scene(BALL)
    view = clbvh.View(transparent=True, background=(0.0, 1.0, 0.0), **SIZE)
    render_turntable(scene, tmp_path / "a.gif", view, frames=1)
    assert frames[1][0, 0].tolist() == [0, 255, 0]


def test_a_tree_is_taken(frames, tmp_path):
    render_turntable(clbvh.build(BALL), tmp_path / "a.gif", frames=1, **SIZE)
    assert frames[1].shape == (30, 40, 3)


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_files_have_all_frames(suffix, tmp_path):
    path = tmp_path / f"a.{suffix}"
    render_turntable(BALL, path, frames=5, frames_per_s=10, shading="lambert", **SIZE)
    if suffix == "gif":
        from PIL import Image

        with Image.open(path) as image:
            assert (image.n_frames, image.size) == (5, (40, 30))
    else:
        assert imageio_ffmpeg.count_frames_and_secs(path)[0] == 5


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_an_error_leaves_no_file(suffix, tmp_path):
    def fail(done, total):
        if done == 2:
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        render_turntable(BALL, tmp_path / f"a.{suffix}", frames=4, shading="lambert", on_frame=fail, **SIZE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("frames", [0, -1, True, 2.5, "8", 90_001, None])
def test_wrong_numbers_of_frames_are_refused(frames, tmp_path):
    with pytest.raises(clbvh.ConfigError, match="frames of a turn"):
        render_turntable(BALL, tmp_path / "a.gif", frames=frames)


@pytest.mark.parametrize("rate", [0, -1.0, np.nan, np.inf, True, "25"])
def test_wrong_rates_are_refused_before_any_work(rate, tmp_path):
    with pytest.raises(clbvh.ConfigError, match="frames_per_s"):
        render_turntable("no such mesh.ply", tmp_path / "a.gif", frames_per_s=rate)


@pytest.mark.parametrize("name", ["a.avi", "a", "missing/a.gif"])
def test_wrong_paths_are_refused_before_any_work(name, tmp_path):
    with pytest.raises(clbvh.ConfigError, match=name):
        render_turntable("no such mesh.ply", tmp_path / name)

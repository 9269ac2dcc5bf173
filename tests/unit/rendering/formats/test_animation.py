"""Animations read back frame by frame, and a failure leaves nothing behind."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from PIL import Image

from clbvh.errors import ConfigError
from clbvh.rendering.series import check_animation, write_animation

COLOURS = [(250, 20, 20), (20, 250, 20), (20, 20, 250), (240, 240, 10)]


def make_frames(height, width):
    return [np.full((height, width, 3), colour, np.uint8) for colour in COLOURS]


def read_video(path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    frames = ffmpeg.read_frames(str(path))
    facts = next(frames)
    width, height = facts["size"]
    return facts, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in frames]


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (12, 16)], ids=str)
def test_a_gif_has_the_frames_and_repeats(tmp_path, size):
    frames = make_frames(*size)
    write_animation(tmp_path / "a.gif", iter(frames), 12.5)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == len(frames)
        assert image.info["loop"] == 0
        for number, frame in enumerate(frames):
            image.seek(number)
            assert image.info["duration"] == 80
            assert (np.asarray(image.convert("RGB")) == frame).all()


def test_a_fast_gif_keeps_two_hundredths_a_frame(tmp_path):
    write_animation(tmp_path / "a.gif", make_frames(4, 4), 1000)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.info["duration"] == 20


# imageio-ffmpeg's reader leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("size", [(16, 24), (15, 24), (16, 23), (17, 33)], ids=str)
def test_a_video_has_the_frames_and_even_sides(tmp_path, size):
    pytest.importorskip("imageio_ffmpeg")
    frames = make_frames(*size)
    write_animation(tmp_path / "a.mp4", frames, 10)
    facts, read = read_video(tmp_path / "a.mp4")
    height, width = size
    assert facts["size"] == (width + width % 2, height + height % 2)
    assert facts["fps"] == 10
    assert facts["codec"] == "h264"
    assert len(read) == len(frames)
    for frame, original in zip(read, frames, strict=True):
        assert np.abs(frame[:height, :width].astype(int) - original).max() < 12
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize("name", ["a.gif", "a.mp4"])
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("frame_count", [0, 1, 3])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, name, error, frame_count):
    if name == "a.mp4":
        pytest.importorskip("imageio_ffmpeg")
    (tmp_path / name).write_bytes(b"old")

    def frames():
        yield from make_frames(8, 8)[:frame_count]
        raise error

    with pytest.raises(error):
        write_animation(tmp_path / name, frames())
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"old"


@pytest.mark.parametrize("rate", [0, -1, np.nan, np.inf, True, "25"])
def test_other_rates_are_refused(tmp_path, rate):
    with pytest.raises(ConfigError, match="frames_per_s"):
        check_animation(tmp_path / "a.gif", rate)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"must end in \.gif or \.mp4"):
        check_animation(tmp_path / "a.avi", 25)
    with pytest.raises(ConfigError, match="does not exist"):
        check_animation(tmp_path / "gone" / "a.gif", 25)
    with pytest.raises(ConfigError, match="a path, not 7"):
        check_animation(7, 25)


def test_a_missing_ffmpeg_is_named_with_the_command_before_the_work(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ConfigError, match="pip install imageio-ffmpeg"):
        check_animation(tmp_path / "a.mp4", 25)
    check_animation(tmp_path / "a.gif", 25)

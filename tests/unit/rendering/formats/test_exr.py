"""EXR files hold every bit, and damaged ones are refused."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

from clbvh.errors import ConfigError, SceneError
from clbvh.rendering.image_files import read_exr, write_exr

OpenEXR = pytest.importorskip("OpenEXR")

CHANNELS = {
    "R": np.array([[0, -0.0, np.inf], [-np.inf, np.nan, 1e-40]], np.float32),
    "depth.Z": np.random.default_rng(0).normal(size=(2, 3)).astype(np.float32),
    "ids.V": np.array([[0, 1, 2**31], [2**32 - 1, 7, 8]], np.uint32),
    "half.Y": np.array([[1, 65504, 6e-8], [0, 1, 2]], np.float16),
}


def encode(channels, attributes=None):
    file = io.BytesIO()
    write_exr(file, channels, attributes)
    return file.getvalue()


def test_channels_read_back_bit_for_bit(tmp_path):
    kept = {name: pixels.copy() for name, pixels in CHANNELS.items()}
    (tmp_path / "a.exr").write_bytes(encode(CHANNELS))
    read = read_exr(tmp_path / "a.exr")
    assert set(read) == set(CHANNELS)
    for name, pixels in kept.items():
        assert read[name].dtype == pixels.dtype
        assert read[name].tobytes() == pixels.tobytes()
        assert CHANNELS[name] is not None


def test_attributes_are_in_the_head():
    read = OpenEXR.File(io.BytesIO(encode(CHANNELS, {"camera": '{"a": "\u00e9"}'})))
    assert read.header()["camera"] == '{"a": "\u00e9"}'


def test_strided_channels_are_written(tmp_path):
    pixels = np.arange(24, dtype=np.float32).reshape(4, 6)[::2, ::-3]
    (tmp_path / "a.exr").write_bytes(encode({"Z": pixels}))
    assert (read_exr(tmp_path / "a.exr")["Z"] == pixels).all()


@pytest.mark.parametrize("kept_bytes", [0, 3, 100, -20, -1])
def test_a_cut_file_is_refused(tmp_path, kept_bytes):
    (tmp_path / "cut.exr").write_bytes(encode(CHANNELS)[:kept_bytes])
    with pytest.raises(SceneError, match=r"cut\.exr: this is no OpenEXR file"):
        read_exr(tmp_path / "cut.exr")


def test_another_file_is_refused(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"solid cube\n" * 40)
    with pytest.raises(SceneError, match="no OpenEXR file"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(SceneError, match="no such file"):
        read_exr(tmp_path / "b.exr")


def test_a_missing_library_is_named_with_the_command(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ConfigError, match="pip install OpenEXR"):
        encode(CHANNELS)
    with pytest.raises(ConfigError, match="pip install OpenEXR"):
        read_exr(tmp_path / "a.exr")

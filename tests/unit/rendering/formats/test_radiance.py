"""Radiance files, plain and compressed, against values by formula; damaged ones are refused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from clbvh.errors import ConfigError, SceneError
from clbvh.rendering.image_files import read_environment_map, read_radiance, write_exr

HEAD = b"#?RADIANCE\n# made by a test\nFORMAT=32-bit_rle_rgbe\n\n"


def compress_row(row):
    """Return a row, (width, 4) uint8, in runs of equal bytes and literal pieces."""
    out = bytearray((2, 2, len(row) >> 8, len(row) & 255))
    for values in row.T.tolist():
        at = 0
        while at < len(values):
            run = 1
            while at + run < len(values) and run < 127 and values[at + run] == values[at]:
                run += 1
            if run > 2:
                out += bytes((128 + run, values[at]))
                at += run
            else:
                piece = values[at : at + min(run, 128)]
                out += bytes((len(piece), *piece))
                at += len(piece)
    return bytes(out)


def make_rgbe(height, width, seed=0):
    generator = np.random.default_rng(seed)
    rgbe = generator.integers(128, 256, (height, width, 4)).astype(np.uint8)
    rgbe[:, width // 3 :] = rgbe[:, width // 3 : width // 3 + 1]  # runs
    rgbe[0, 0, 3] = 0
    rgbe[-1, -1, 3] = 1
    return rgbe


def colours_of(rgbe):
    exponent = rgbe[..., 3:].astype(int)
    return np.where(exponent > 0, rgbe[..., :3] * 2.0 ** (exponent - 136), 0.0)


def write(path, rgbe, *, compressed=True, head=HEAD, size=None):
    height, width = rgbe.shape[:2]
    rows = b"".join(map(compress_row, rgbe)) if compressed else rgbe.tobytes()
    path.write_bytes(head + (size or f"-Y {height} +X {width}\n".encode()) + rows)
    return path


@pytest.mark.parametrize("compressed", [True, False], ids=["runs", "plain"])
@pytest.mark.parametrize("size", [(1, 8), (3, 9), (5, 700)], ids=str)
def test_pixels_are_those_of_the_formula(tmp_path, size, compressed):
    rgbe = make_rgbe(*size)
    pixels = read_radiance(write(tmp_path / "a.hdr", rgbe, compressed=compressed))
    assert pixels.dtype == np.float32
    assert (pixels == colours_of(rgbe)).all()


def test_narrow_rows_are_plain(tmp_path):
    rgbe = make_rgbe(2, 3)
    assert (read_radiance(write(tmp_path / "a.hdr", rgbe, compressed=False)) == colours_of(rgbe)).all()


def test_exposures_are_divided_out(tmp_path):
    rgbe = make_rgbe(2, 9)
    head = HEAD.replace(b"\n\n", b"\nEXPOSURE= 4\nEXPOSURE=0.5\n\n")
    assert (read_radiance(write(tmp_path / "a.hdr", rgbe, head=head)) == colours_of(rgbe) / 2).all()


@pytest.mark.parametrize(("size", "rows", "columns"), [(b"+Y 2 +X 9\n", -1, 1), (b"-Y 2 -X 9\n", 1, -1)])
def test_other_orders_are_turned(tmp_path, size, rows, columns):
    rgbe = make_rgbe(2, 9)
    pixels = read_radiance(write(tmp_path / "a.hdr", rgbe, size=size))
    assert (pixels == colours_of(rgbe)[::rows, ::columns]).all()


@pytest.mark.parametrize("compressed", [True, False], ids=["runs", "plain"])
@pytest.mark.parametrize("missing", [1, 5, 60])
def test_a_cut_file_is_refused(tmp_path, compressed, missing):
    path = write(tmp_path / "cut.hdr", make_rgbe(3, 40), compressed=compressed)
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(SceneError, match=r"cut\.hdr: .*row 2 of 3"):
        read_radiance(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no Radiance file"),
        (b"\x89PNG\r\n", "no Radiance file"),
        (HEAD, "no Radiance file"),
        (HEAD + b"-Y 2 +Z 3\n", "the size must read"),
        (HEAD + b"-Y 0 +X 3\n", "empty or too large"),
        (HEAD + b"-Y 999999999 +X 999999999\n", "empty or too large"),
        (HEAD.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\n1234", "must be 32-bit_rle_rgbe"),
        (HEAD.replace(b"\n\n", b"\nEXPOSURE=no\n\n") + b"-Y 1 +X 1\n1234", "exposure must be above 0"),
        (HEAD.replace(b"\n\n", b"\nEXPOSURE=0\n\n") + b"-Y 1 +X 1\n1234", "exposure must be above 0"),
        (HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09" + b"\x00\x89\x07" * 4, "row 0 of 1 is damaged"),
        (HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09" + b"\x8a\x07" * 40, "row 0 of 1 is damaged"),
        (HEAD + b"-Y 1 +X 3\n" + b"\x01\x01\x01\x03" * 3, "run-length code of old files"),
    ],
    ids=["empty", "png", "no size", "axes", "no rows", "huge", "xyze", "word", "zero", "count 0", "too long", "old"],
)
def test_a_damaged_file_is_refused(tmp_path, content, words):
    (tmp_path / "bad.hdr").write_bytes(content)
    with pytest.raises(SceneError, match=words):
        read_radiance(tmp_path / "bad.hdr")


@pytest.mark.parametrize("seed", range(3))
def test_any_change_of_bytes_gives_pixels_or_one_error(tmp_path, seed):
    generator = np.random.default_rng(seed)
    path = write(tmp_path / "a.hdr", make_rgbe(4, 20))
    content = path.read_bytes()
    for _ in range(100):
        changed = bytearray(content)
        for at in generator.integers(0, len(content), 3):
            changed[at : at + generator.integers(0, 3)] = generator.bytes(int(generator.integers(0, 4)))
        path.write_bytes(changed)
        with suppress(SceneError):
            pixels = read_radiance(path)
            assert pixels.dtype == np.float32
            assert pixels.ndim == 3


class TestEnvironmentMaps:
    def test_a_radiance_file(self, tmp_path):
        rgbe = make_rgbe(4, 8)
        assert (read_environment_map(str(write(tmp_path / "a.HDR", rgbe))) == colours_of(rgbe)).all()

    @pytest.mark.parametrize("names", [("R", "G", "B"), ("Y", "Y", "Y")], ids=["rgb", "grey"])
    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_an_exr_file(self, tmp_path, names, dtype):
        pytest.importorskip("OpenEXR")
        pixels = np.random.default_rng(0).uniform(-0.1, 9, (3, 6, 3)).astype(dtype)
        if names[0] == "Y":
            pixels[:] = pixels[..., :1]
        with (tmp_path / "a.exr").open("wb") as file:
            write_exr(file, {name: pixels[..., channel] for channel, name in enumerate(names)})
        read = read_environment_map(tmp_path / "a.exr")
        assert read.dtype == np.float32
        assert (read == np.maximum(pixels, 0).astype(np.float32)).all()

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_values_that_are_not_finite_are_refused(self, tmp_path, value):
        pytest.importorskip("OpenEXR")
        pixels = np.ones((2, 3), np.float32)
        pixels[1, 2] = value
        with (tmp_path / "a.exr").open("wb") as file:
            write_exr(file, {"Y": pixels})
        with pytest.raises(SceneError, match="finite"):
            read_environment_map(tmp_path / "a.exr")

    def test_other_channels_are_refused(self, tmp_path):
        pytest.importorskip("OpenEXR")
        with (tmp_path / "a.exr").open("wb") as file:
            write_exr(file, {"R": np.ones((2, 3), np.float32), "depth.Z": np.ones((2, 3), np.float32)})
        with pytest.raises(SceneError, match=r"this file has R, depth\.Z"):
            read_environment_map(tmp_path / "a.exr")

    def test_a_missing_library_is_named_with_the_command(self, tmp_path, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
        with pytest.raises(ConfigError, match="pip install OpenEXR"):
            read_environment_map(tmp_path / "a.exr")

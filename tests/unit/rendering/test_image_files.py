"""Files of pictures, of hits and of light: whole or absent, read back as they were, and refused where damaged."""

import io
from contextlib import suppress

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh import ConfigError, SceneError
from clbvh.rendering import image_files as files

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def test_a_picture_reads_back_as_it_was_or_close_to_it(tmp_path):
    for name in ("a.png", "a.PPM"):
        files.write_picture(tmp_path / name, RGB)
        assert (imageio.imread(tmp_path / name) == RGB).all()
    rows, columns, _ = np.indices((64, 96, 3))
    smooth = (rows + columns).astype(np.uint8)
    smooth[20:40, 30:60] = 250, 10, 30  # edges, also of colours
    files.write_picture(tmp_path / "a.JPEG", smooth)
    assert (tmp_path / "a.JPEG").read_bytes()[:3] == b"\xff\xd8\xff"
    assert np.abs(imageio.imread(tmp_path / "a.JPEG").astype(int) - smooth).max() <= 12
    # A new file has the rights of any other.
    (tmp_path / "other").touch()
    assert (tmp_path / "a.PPM").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_other_names_are_refused_before_the_work(tmp_path):
    (tmp_path / "folder.ppm").mkdir()
    with_alpha = np.dstack((RGB, RGB[..., 0]))
    rows = [
        ("a.gif", RGB, r"must end in \.png"), ("a", RGB, r"must end in \.png"), ("gone/a.ppm", RGB, "does not exist"),
        ("folder.ppm", RGB, "this is a folder"), ("a.jpg", with_alpha, r"a \.jpg file has no transparency"),
        ("a.ppm", with_alpha, r"a \.ppm file has no transparency; write a \.png"),
    ]  # fmt: skip
    for name, pixels, words in rows:
        with pytest.raises(ConfigError, match=words):
            files.write_picture(tmp_path / name, pixels)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.ppm"]


def encode_exr(channels, attributes=None):
    pytest.importorskip("OpenEXR")
    file = io.BytesIO()
    files.write_exr(file, channels, attributes)
    return file.getvalue()


def test_damaged_exr_files_are_refused(tmp_path):
    content = encode_exr({"R": RGB[..., 0].astype(np.float32)}, {"camera": '{"a": "\u00e9"}'})
    for damaged in (b"", content[:3], content[:100], content[:-20], content[:-1], b"solid cube\n" * 40):
        (tmp_path / "a.exr").write_bytes(damaged)
        with pytest.raises(SceneError, match=r"a\.exr: this is no OpenEXR file"):
            files.read_exr(tmp_path / "a.exr")


def test_environment_maps_are_colours_or_grey(tmp_path):
    path, pixels = tmp_path / "a.exr", np.random.default_rng(0).uniform(-0.1, 9, (3, 6, 3)).astype(np.float16)
    for names in ("RGB", "Y"):
        path.write_bytes(encode_exr({name: pixels[..., number] for number, name in enumerate(names)}))
        read = files.read_environment_map(path)
        assert read.dtype == np.float32
        assert (read == np.maximum(pixels[..., : len(names)], 0)).all()
    for channels, words in (({"Y": np.float32([[1, np.nan]])}, "finite"), ({"R": pixels[..., 0]}, "this file has R")):
        path.write_bytes(encode_exr(channels))
        with pytest.raises(SceneError, match=words):
            files.read_environment_map(path)


HEAD = b"#?RADIANCE\n# made by a test\nFORMAT=32-bit_rle_rgbe\n\n"


def compress_row(row):
    """Return a row, (width, 4) uint8, as literal pieces of up to 128 bytes, and its second half, a run, in runs."""
    out = bytearray((2, 2, len(row) >> 8, len(row) & 255))
    half = len(row) // 2
    for values in row.T:
        for at in range(0, half, 128):
            piece = values[at : min(at + 128, half)]
            out += bytes((len(piece), *piece.tolist()))
        for at in range(half, len(row), 127):
            out += bytes((128 + min(127, len(row) - at), values[at]))
    return bytes(out)


def write(path, rgbe, *, compressed=True, head=HEAD, size=None):
    height, width = rgbe.shape[:2]
    rows = b"".join(map(compress_row, rgbe)) if compressed else rgbe.tobytes()
    path.write_bytes(head + (size or f"-Y {height} +X {width}\n".encode()) + rows)
    return path


def make_rgbe(height, width):
    rgbe = np.random.default_rng(0).integers(129, 256, (height, width, 4)).astype(np.uint8)
    rgbe[:, width // 2 :] = 128  # a run
    rgbe[0, 0, 3], rgbe[0, 1, 3] = 0, 1
    exponent = rgbe[..., 3:].astype(int)
    return rgbe, np.where(exponent > 0, rgbe[..., :3] * 2.0 ** (exponent - 136), 0.0)


def test_radiance_pixels_are_those_of_the_formula(tmp_path):
    path = tmp_path / "a.hdr"
    for size in ((1, 8), (3, 9), (5, 700)):
        rgbe, colours = make_rgbe(*size)
        for compressed in (True, False):
            pixels = files.read_radiance(write(path, rgbe, compressed=compressed))
            assert pixels.dtype == np.float32
            assert (pixels == colours).all()
    rgbe, colours = make_rgbe(2, 3)
    assert (files.read_environment_map(str(write(tmp_path / "b.HDR", rgbe, compressed=False))) == colours).all()
    # Exposures are divided out, and other orders are turned.
    rgbe, colours = make_rgbe(2, 9)
    head = HEAD.replace(b"\n\n", b"\nEXPOSURE= 4\nEXPOSURE=0.5\n\n")
    assert (files.read_radiance(write(path, rgbe, head=head)) == colours / 2).all()
    assert (files.read_radiance(write(path, rgbe, size=b"+Y 2 +X 9\n")) == colours[::-1]).all()
    assert (files.read_radiance(write(path, rgbe, size=b"-Y 2 -X 9\n")) == colours[:, ::-1]).all()


def test_damaged_radiance_files_are_refused(tmp_path):
    path = tmp_path / "bad.hdr"
    head, one = HEAD + b"-Y 1 +X 9\n\x02\x02\x00\x09", b"-Y 1 +X 1\n1234"
    rows = [
        (b"\x89PNG\r\n", "no Radiance file"), (HEAD, "no Radiance file"), (HEAD + b"-Y 2 +Z 3\n", "the size must read"),
        (HEAD + b"-Y 999999999 +X 999999999\n", "empty or too large"),
        (HEAD.replace(b"rgbe", b"xyze") + one, "must be 32-bit_rle_rgbe"),
        (HEAD.replace(b"\n\n", b"\nEXPOSURE=no\n\n") + one, "exposure must be above 0"),
        (head + b"\x00\x89\x07" * 4, "row 0 of 1 is damaged"), (head + b"\x8a\x07" * 40, "row 0 of 1 is damaged"),
        (HEAD + b"-Y 1 +X 3\n" + b"\x01\x01\x01\x03" * 3, "run-length code of old files"),
    ]  # fmt: skip
    rgbe, _ = make_rgbe(3, 40)
    for compressed in (True, False):
        whole = write(path, rgbe, compressed=compressed).read_bytes()
        rows += [(whole[:-missing], r"bad\.hdr: .*row 2 of 3") for missing in (1, 5)]
    for content, words in rows:
        path.write_bytes(content)
        with pytest.raises(SceneError, match=words):
            files.read_radiance(path)
    # Any change of bytes gives pixels or one error.
    generator, whole = np.random.default_rng(0), write(path, make_rgbe(4, 20)[0]).read_bytes()
    for _ in range(200):
        changed = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            changed[at : at + generator.integers(0, 3)] = generator.bytes(int(generator.integers(0, 4)))
        path.write_bytes(changed)
        with suppress(SceneError):
            assert files.read_radiance(path).ndim == 3

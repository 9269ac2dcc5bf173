"""Pictures beside mesh files: found under other names, decoded from any depth, and refused when they are too much."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from clbvh.errors import MeshError
from clbvh.geometry.loading.file_mesh import Problems
from clbvh.geometry.loading.texture_files import TextureFiles, decode_image, find_file


def encode(image, kind="PNG", **options):
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def test_pixels_of_any_mode_become_four_bytes():
    grey = np.array([[0, 100, 255]], np.uint8)
    expected = np.dstack([grey] * 3 + [np.full_like(grey, 255)])
    palette = Image.fromarray(grey).convert("P")
    for image in (Image.fromarray(grey), palette, Image.fromarray(expected), Image.fromarray(expected[..., :3])):
        np.testing.assert_array_equal(decode_image(encode(image)), expected)
    wide = Image.fromarray(np.rint(grey * 257.0).astype(np.uint16))
    np.testing.assert_array_equal(decode_image(encode(wide)), expected)
    np.testing.assert_array_equal(decode_image(encode(Image.fromarray(grey / np.float32(255)), "TIFF")), expected)


def test_the_top_row_is_the_first_one():
    pixels = np.arange(24, dtype=np.uint8).reshape(4, 2, 3)
    for kind in ("PNG", "BMP", "TGA", "TIFF"):
        np.testing.assert_array_equal(decode_image(encode(Image.fromarray(pixels), kind))[..., :3], pixels)


def huge_png(width, height):
    """Return a PNG file that claims a size, and has no pixels."""
    content = b"\x89PNG\r\n\x1a\n"
    for chunk in (b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0), b"IDAT"):
        content += struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return content


@pytest.mark.parametrize(("width", "height"), [(16_385, 1), (1, 2**31 - 1), (60_000, 60_000)])
def test_a_picture_that_claims_to_be_huge_is_refused_before_it_is_decoded(width, height):
    with pytest.raises((MeshError, Image.DecompressionBombError), match=r"more than 16,384 on a side|exceeds limit"):
        decode_image(huge_png(width, height))


def test_a_file_that_would_start_a_program_is_no_picture():
    with pytest.raises(MeshError, match="no picture in a format"):
        decode_image(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n")


OTHER_NAMES = ["maps/Wood.PNG", "maps\\Wood.PNG", "wood.png", "C:\\old\\wood.png", '"wood.png"', "x/WOOD.png"]


@pytest.mark.parametrize("name", OTHER_NAMES)
def test_files_are_found_under_the_names_of_other_machines(tmp_path, name):
    (tmp_path / "maps").mkdir()
    for place in ("maps/wood.png", "wood.png"):
        (tmp_path / place).write_bytes(b"")
    found = find_file(tmp_path, name)
    assert found.samefile(tmp_path / ("maps" if name.startswith("maps") else "") / "wood.png")


def test_a_texture_is_read_once_for_each_use(tmp_path):
    (tmp_path / "a.png").write_bytes(encode(Image.new("RGB", (2, 2))))
    problems = Problems()
    files = TextureFiles(tmp_path, problems)
    texture = files.read("a.png", is_srgb=True)
    assert files.read("A.PNG", is_srgb=True) is texture
    assert not files.read("a.png", is_srgb=False).is_srgb
    assert files.read("b.png", is_srgb=True) is None


def test_a_damaged_picture_is_a_problem(tmp_path):
    content = encode(Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)))
    (tmp_path / "a.png").write_bytes(content[: len(content) // 2])
    problems = Problems()
    assert TextureFiles(tmp_path, problems).read("a.png", is_srgb=True) is None
    with pytest.warns(UserWarning, match=r"x\.obj: the texture .*a\.png cannot be"):
        problems.warn("x.obj")

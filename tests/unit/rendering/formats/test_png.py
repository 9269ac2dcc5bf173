"""PNG files are read by others as they were, for any size, depth and number of threads."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from clbvh.errors import ConfigError
from clbvh.rendering.formats import png
from clbvh.rendering.formats.png import encode_png

SIZES = [(1, 1), (1, 7), (7, 1), (5, 3), (64, 33)]


def make_pixels(shape, dtype, seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def read_chunks(data):
    """Yield the kind and the content of each chunk; the check sums are compared."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at = 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        content = data[at + 8 : at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + content)
        yield kind, content
        at += 12 + length


def decode(data):
    """Return the pixels of a file that uses the filter of the row above alone, (height, width, channels)."""
    chunks = dict(read_chunks(data))
    width, height, bits, colour_type, *others = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert others == [0, 0, 0]
    channel_count = {0: 1, 4: 2, 2: 3, 6: 4}[colour_type]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, -1)
    assert (rows[:, 0] == 2).all()
    plain = np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8)
    return plain.reshape(-1).view(f">u{bits // 8}").reshape(height, width, channel_count)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channel_count", [1, 2, 3, 4])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_pixels_read_back_as_they_were(size, channel_count, dtype):
    pixels = make_pixels((*size, channel_count), dtype)
    assert (decode(encode_png(pixels)) == pixels).all()


@pytest.mark.parametrize(("channel_count", "mode"), [(1, "L"), (2, "LA"), (3, "RGB"), (4, "RGBA")])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_pillow_reads_eight_bits(size, channel_count, mode):
    pixels = make_pixels((*size, channel_count), np.uint8)
    image = Image.open(io.BytesIO(encode_png(pixels)))
    assert image.mode == mode
    assert (np.asarray(image).reshape(pixels.shape) == pixels).all()


def test_pillow_reads_sixteen_bits_of_grey():
    pixels = make_pixels((9, 4), np.uint16)
    assert (np.asarray(Image.open(io.BytesIO(encode_png(pixels)))) == pixels).all()


@pytest.mark.parametrize("thread_count", [1, 2, 5])
def test_many_bands_are_one_stream_for_any_number_of_threads(monkeypatch, thread_count):
    pixels = make_pixels((50, 31, 3), np.uint8, seed=1)
    monkeypatch.setattr(png, "_BAND_BYTES", 400)
    whole = encode_png(pixels)
    monkeypatch.setattr(png, "HostThreads", lambda: original(thread_count))
    assert (decode(whole) == pixels).all()
    assert encode_png(pixels) == whole


original = png.HostThreads


def test_zlib_stands_in_for_the_library(monkeypatch):
    pixels = make_pixels((20, 30, 3), np.uint8)
    monkeypatch.setattr(png, "_deflate", zlib)
    assert (decode(encode_png(pixels)) == pixels).all()


def test_strided_and_read_only_pixels_are_written():
    pixels = make_pixels((20, 30, 4), np.uint16)[::2, ::-3, :3]
    pixels.flags.writeable = False
    assert (decode(encode_png(pixels)) == pixels).all()


def test_notes_are_read_back():
    image = Image.open(io.BytesIO(encode_png(np.zeros((2, 2), np.uint8), {"clbvh": '{"a": 1}', "Title": "\u4e2d"})))
    assert image.text == {"clbvh": '{"a": 1}', "Title": "\u4e2d"}


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((2, 2), np.float32),
        np.zeros((2, 2, 5), np.uint8),
        np.zeros(4, np.uint8),
        np.zeros((0, 3, 3), np.uint8),
        np.zeros((3, 0), np.uint8),
    ],
    ids=["float", "five channels", "a row", "no rows", "no columns"],
)
def test_other_pixels_are_refused(pixels):
    with pytest.raises(ConfigError, match="the pixels of an image file"):
        encode_png(pixels)

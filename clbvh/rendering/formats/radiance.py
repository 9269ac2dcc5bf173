"""Radiance files, ``.hdr``: pixels of red, green and blue with a common exponent.

The format: Ward, "Real Pixels", Graphics Gems II, 1991, and Radiance's own "The RADIANCE Picture Format".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...support.memory import check_memory
from ...support.regular_file import read_errors_as, read_regular

_MAGIC = (b"#?RADIANCE", b"#?RGBE")
_FORMAT = b"32-bit_rle_rgbe"

# Rows of other lengths are never compressed channel by channel.
_LEAST_COMPRESSED, _MOST_COMPRESSED = 8, 0x7FFF

# A count byte above this begins a run of count - 128 equal bytes.
_RUN = 128

# Exponents are kept with this offset, and mantissas are of 8 bits.
_EXPONENT_BIAS = 128 + 8

_MOST_PIXELS = 1 << 30

# Of each pixel: the bytes of the file, and three channels of float32.
_PIXEL_BYTES = 4 + 12


def read_radiance(path: Path) -> NDArray[np.float32]:
    """Return the pixels of a Radiance file, (height, width, 3) float32, row 0 at the top.

    Its exposures are divided out, so that the values are the scene's.

    Raises
    ------
    SceneError
        The file cannot be read, is damaged, or holds other pixels than RGBE.
    """
    with read_errors_as(SceneError, path):
        content = read_regular(Path(path))
    lines, begin = _read_head(path, content)
    exposure, width, height, turned_rows, turned_columns = _parse_head(path, lines)
    check_memory(f"the picture {path}", width * height * _PIXEL_BYTES, SceneError)
    rgbe = _read_rows(path, content, begin, width, height)
    # As most programs read it; Radiance itself takes the middle of a mantissa's range. Exponent 0 is black.
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - _EXPONENT_BIAS)
    scale[rgbe[..., 3] == 0] = 0
    pixels = rgbe[..., :3] * scale[..., None]
    if exposure != 1.0:
        pixels = (pixels / exposure).astype(np.float32)
    return np.ascontiguousarray(pixels[:: -1 if turned_rows else 1, :: -1 if turned_columns else 1])


def _read_head(path: Path, content: bytes) -> tuple[list[bytes], int]:
    """Return the lines of the head with that of the size, and the offset of the pixels."""
    blank = content.find(b"\n\n")
    end = content.find(b"\n", blank + 2)
    if not content.startswith(_MAGIC) or blank < 0 or end < 0:
        raise SceneError(f"{path}: this is no Radiance file: it must begin with #?RADIANCE and hold a size")
    return [*content[:blank].split(b"\n"), content[blank + 2 : end]], end + 1


def _parse_head(path: Path, lines: list[bytes]) -> tuple[float, int, int, bool, bool]:
    """Return the exposure, the width, the height, and whether rows go upwards and columns to the left."""
    exposure = 1.0
    for line in lines[1:-1]:
        name, _, value = line.partition(b"=")
        if name.strip() == b"FORMAT" and value.strip() != _FORMAT:
            raise SceneError(f"{path}: the pixels must be {_FORMAT.decode()}, not {value.strip()!r}")
        if name.strip() == b"EXPOSURE":
            exposure *= _parse_exposure(path, value)
    size = re.fullmatch(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})\s*", lines[-1])
    if size is None:
        raise SceneError(f"{path}: the size must read like '-Y 512 +X 1024', not {lines[-1][:40]!r}")
    height, width = int(size[2]), int(size[4])
    if not 0 < width * height <= _MOST_PIXELS:
        raise SceneError(f"{path}: the size {width} x {height} is empty or too large")
    return exposure, width, height, size[1] == b"+", size[3] == b"-"


def _parse_exposure(path: Path, value: bytes) -> float:
    try:
        exposure = float(value)
    except ValueError:
        exposure = 0.0
    if not 0 < exposure < np.inf:
        raise SceneError(f"{path}: the exposure must be above 0, not {value.strip()!r}")
    return exposure


def _read_rows(path: Path, content: bytes, begin: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return (height, width, 4) uint8: the mantissas and the exponents."""
    row_head = bytes((2, 2, width >> 8, width & 0xFF)) if _LEAST_COMPRESSED <= width <= _MOST_COMPRESSED else None
    rgbe = np.empty((height, width, 4), np.uint8)
    at = begin
    for row in range(height):
        if row_head is not None and content.startswith(row_head, at):
            channels, at = _read_compressed_row(content, at + len(row_head), width)
            if channels is None:
                raise SceneError(f"{path}: row {row} of {height} is damaged, or the file ends in it")
            rgbe[row] = np.frombuffer(channels, np.uint8).reshape(4, width).T
            continue
        plain = content[at : at + 4 * width]
        if len(plain) < 4 * width:
            raise SceneError(f"{path}: the file ends in row {row} of {height}")
        rgbe[row] = np.frombuffer(plain, np.uint8).reshape(width, 4)
        if (rgbe[row, :, :3] == 1).all(axis=1).any():
            raise SceneError(f"{path}: row {row} has the run-length code of old files, which is not read: save it anew")
        at += 4 * width
    return rgbe


def _read_compressed_row(content: bytes, at: int, width: int) -> tuple[bytearray | None, int]:
    """Return the four channels of a row one after the other, None if it is damaged, and the offset behind it."""
    channels = bytearray()
    for channel in range(1, 5):
        end = channel * width
        while len(channels) < end:
            if at >= len(content):
                return None, at
            count = content[at]
            if count > _RUN:
                channels += content[at + 1 : at + 2] * (count - _RUN)
                at += 2
            else:
                channels += content[at + 1 : at + 1 + count]
                at += 1 + count
            if count == 0 or at > len(content):
                return None, at
        if len(channels) > end:
            return None, at
    return channels, at

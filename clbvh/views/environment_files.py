"""Files of environments: Radiance, and OpenEXR by the optional library of that name.

Radiance is read here, for which imageio downloads a library: Ward, "Real Pixels", Graphics Gems II, 1991, and "The
RADIANCE Picture Format". Its pixels are red, green and blue with a common exponent.
"""

from __future__ import annotations

import io
import os
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, SceneError
from ..support.files import read_errors_as, read_regular
from ..support.memory import check_memory


def read_environment_map(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Return the linear colours of an environment map, (height, width, 3) float32, row 0 at the top.

    Parameters
    ----------
    path : str or path
        A Radiance file, ``.hdr``, or an OpenEXR file, ``.exr``, with the channels R, G and B, or with Y alone. Values
        below 0, which resampling leaves, become 0.

    Raises
    ------
    SceneError
        A file that cannot be read or is damaged, other channels, or a value that is not finite.
    ConfigError
        An ``.exr`` file, and OpenEXR is not installed.
    """
    path = Path(path)
    pixels = read_radiance(path) if path.suffix.lower() == ".hdr" else _read_exr_colours(path)
    if not np.isfinite(pixels).all():
        raise SceneError(f"{path}: an environment map must hold finite values, but some are not")
    return np.maximum(pixels, np.float32(0))


def _read_exr_colours(path: Path) -> NDArray[np.float32]:
    channels = read_exr(path)
    names = ("R", "G", "B") if "R" in channels else ("Y", "Y", "Y")
    missing = [name for name in names if name not in channels]
    if missing:
        raise SceneError(
            f"{path}: an environment map must have the channels R, G and B, or Y, and this file has "
            f"{', '.join(sorted(channels))}"
        )
    parts = [channels[name] for name in names]
    if len({part.shape for part in parts}) != 1:
        raise SceneError(f"{path}: the channels of an environment map must have one size")
    return np.stack(parts, axis=-1).astype(np.float32)


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
    blank = content.find(b"\n\n")
    end = content.find(b"\n", blank + 2)
    if not content.startswith(_MAGIC) or blank < 0 or end < 0:
        raise SceneError(f"{path}: this is no Radiance file: it must begin with #?RADIANCE and hold a size")
    size = re.fullmatch(rb"([-+])Y (\d{1,9}) ([-+])X (\d{1,9})\s*", content[blank + 2 : end])
    if size is None:
        raise SceneError(f"{path}: the size must read like '-Y 512 +X 1024', not {content[blank + 2 : end][:40]!r}")
    height, width = int(size[2]), int(size[4])
    if not 0 < width * height <= _MOST_PIXELS:
        raise SceneError(f"{path}: the size {width} x {height} is empty or too large")
    exposure = _read_exposure(path, content[:blank].split(b"\n")[1:])
    check_memory(f"the picture {path}", width * height * _PIXEL_BYTES, SceneError)
    rgbe = _read_rows(path, content, end + 1, width, height)
    # As most programs read it; Radiance itself takes the middle of a mantissa's range. Exponent 0 is black.
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - _EXPONENT_BIAS)
    scale[rgbe[..., 3] == 0] = 0
    pixels = rgbe[..., :3] * scale[..., None]
    if exposure != 1.0:
        pixels = (pixels / exposure).astype(np.float32)
    # Rows may go upwards, and columns to the left.
    return np.ascontiguousarray(pixels[:: -1 if size[1] == b"+" else 1, :: -1 if size[3] == b"-" else 1])


def _read_exposure(path: Path, lines: list[bytes]) -> float:
    """Return the product of all exposures of a head; raise `SceneError` for another format of pixels."""
    exposure = 1.0
    for line in lines:
        name, _, value = (part.strip() for part in line.partition(b"="))
        if name == b"FORMAT" and value != _FORMAT:
            raise SceneError(f"{path}: the pixels must be {_FORMAT.decode()}, not {value!r}")
        if name == b"EXPOSURE":
            try:
                exposure *= float(value)
            except ValueError:
                exposure = 0.0
            if not 0 < exposure < np.inf:
                raise SceneError(f"{path}: the exposure must be above 0, not {value!r}")
    return exposure


def _read_rows(path: Path, content: bytes, at: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return (height, width, 4) uint8: the mantissas and the exponents."""
    row_head = bytes((2, 2, width >> 8, width & 0xFF)) if _LEAST_COMPRESSED <= width <= _MOST_COMPRESSED else None
    rgbe = np.empty((height, width, 4), np.uint8)
    for row in range(height):
        if row_head is not None and content.startswith(row_head, at):
            channels, at = _read_compressed_row(content, at + len(row_head), width)
            if len(channels) != 4 * width or at > len(content):
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


def _read_compressed_row(content: bytes, at: int, width: int) -> tuple[bytearray, int]:
    """Return the four channels of a row one after the other, not complete if damaged, and the offset behind it."""
    channels = bytearray()
    for end in range(width, 4 * width + 1, width):
        while len(channels) < end:
            count = content[at] if at < len(content) else 0
            if count == 0:
                return bytearray(), at
            if count > _RUN:
                channels += content[at + 1 : at + 2] * (count - _RUN)
                at += 2
            else:
                channels += content[at + 1 : at + 1 + count]
                at += 1 + count
        if len(channels) > end:
            return bytearray(), at
    return channels, at


def import_openexr() -> ModuleType:
    """Return the library, or raise a `ConfigError` that says how to install it."""
    try:
        import OpenEXR
    except ImportError as error:
        raise ConfigError(f"EXR files need OpenEXR: run 'pip install OpenEXR' ({error})") from error
    return OpenEXR


def read_exr(path: Path) -> dict[str, NDArray[Any]]:
    """Return the channels of the first part of an OpenEXR file, each (height, width) float16, float32 or uint32.

    Raises
    ------
    ConfigError
        OpenEXR is not installed.
    SceneError
        The file cannot be read.
    """
    openexr = import_openexr()
    with read_errors_as(SceneError, path):
        content = read_regular(Path(path))
    try:
        read = openexr.File(io.BytesIO(content), separate_channels=True)
        channels = {name: channel.pixels for name, channel in read.channels().items()}
    except Exception as error:
        # The library raises RuntimeError, ValueError and others.
        raise SceneError(f"{path}: this is no OpenEXR file, or a damaged one: {error}") from error
    if not channels:
        raise SceneError(f"{path}: this OpenEXR file has no channels")
    return channels

"""Files of pictures and of hits, written completely or not at all, and text in pictures.

PNG and JPEG by imageio and Pillow, OpenEXR by the optional library of that name. Radiance is read here, for which
imageio downloads a library: Ward, "Real Pixels", Graphics Gems II, 1991, and "The RADIANCE Picture Format". Its pixels
are red, green and blue with a common exponent.
"""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, SceneError
from ..geometry import Mesh
from ..support.files import as_path, check_target, read_errors_as, read_regular, write_atomically
from ..support.memory import check_memory
from ..trace.hits.hits import Hits

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm")
HITS_SUFFIX = ".npz"

_CHANNELS_WITH_ALPHA = 4

# How Pillow writes files of each kind. PNG: of zlib, where level 6 takes five times as long for 3840 x 2160 pixels and
# saves a tenth of the bytes. JPEG: with the colours of each pixel, and a quality at which steps are hard to see.
_PILLOW_OPTIONS: dict[str, dict[str, Any]] = {".png": {"compress_level": 1}, ".jpg": {"quality": 95, "subsampling": 0}}

# Rows of a capital letter, and of the gaps around it, at the scale 1; the size of such a font.
TEXT_ROWS, GAP = 7, 1
_FONT_SIZE = 10

# sRGB, of letters and of what is behind them.
INK = (235, 238, 242)
GROUND = (20, 24, 29)


def check_picture_path(path: Path) -> None:
    """Raise `ConfigError` unless a picture can be written there; for checks before the work begins."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ConfigError(f"{path}: a picture's name must end in {', '.join(PICTURE_SUFFIXES)}")
    check_target(path)


def check_has_alpha(path: Path) -> None:
    """Raise `ConfigError` unless a file of this name can have a transparent background."""
    if path.suffix.lower() != ".png":
        raise ConfigError(f"{path}: a {path.suffix} file has no transparency; write a .png file")


def check_hits_path(path: Path) -> None:
    """Raise `ConfigError` unless hits can be written there."""
    if path.suffix.lower() != HITS_SUFFIX:
        raise ConfigError(f"{path}: the name of a hits file must end in {HITS_SUFFIX}")
    check_target(path)


def write_picture(path: str | os.PathLike[str], rgb: NDArray[np.uint8]) -> None:
    """Write a picture as PNG, JPEG or PPM (P6), by the suffix of the name.

    Parameters
    ----------
    path : str or path
    rgb : (height, width, 3) uint8, or (height, width, 4) with alpha

    Raises
    ------
    ConfigError
        The path has another suffix, or the file cannot be written.
    """
    path = as_path(path)
    check_picture_path(path)
    if rgb.shape[2] == _CHANNELS_WITH_ALPHA:
        check_has_alpha(path)
    encoded = encode_picture(rgb, path.suffix.lower())
    write_atomically(path, lambda file: file.write(encoded))


def encode_picture(rgb: NDArray[np.uint8], suffix: str) -> bytes:
    """Return the bytes of a picture file.

    Parameters
    ----------
    rgb : (height, width, 3) uint8
    suffix : str
        One of `PICTURE_SUFFIXES`.
    """
    if suffix == ".ppm":
        return encode_ppm(rgb)
    import imageio.v3  # here, because it takes 60 ms and pictures need not be files

    kind = suffix.replace("jpeg", "jpg")
    return imageio.v3.imwrite("<bytes>", rgb, plugin="pillow", extension=kind, **_PILLOW_OPTIONS[kind])


def encode_ppm(pixels: NDArray[Any]) -> bytes:
    """Return the bytes of a PPM file, (height, width, 3) uint8 or uint16, or of a PGM file, (height, width)."""
    kind, most = "P5" if pixels.ndim == 2 else "P6", np.iinfo(pixels.dtype).max
    head = f"{kind}\n{pixels.shape[1]} {pixels.shape[0]}\n{most}\n".encode()
    # The high byte comes first.
    return head + pixels.astype(pixels.dtype.newbyteorder(">"), copy=False).tobytes()


def draw_text(pixels: NDArray[np.uint8], text: str, top: int, middle: int, scale: int) -> None:
    """Draw text into (height, width, 3) pixels, centred at a column; what does not fit is cut off at its end."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(pixels)
    place = max(0, middle - width_of(text, scale) // 2), top + TEXT_ROWS * scale
    ImageDraw.Draw(image).text(place, text, fill=INK, font=_load_font(scale), anchor="ls")
    pixels[:] = np.asarray(image)


def width_of(text: str, scale: int) -> int:
    """Return the pixels that a text takes."""
    return math.ceil(_load_font(scale).getlength(text))


@cache
def _load_font(scale: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(_FONT_SIZE * scale)


def write_hits(path: Path, hits: Hits, geometry_names: Sequence[str], instance_names: Sequence[str]) -> None:
    """Write hits as a numpy archive, in which nothing is pickled.

    Parameters
    ----------
    path : Path
    hits : Hits
        Their t, u, v, prim_id, geometry_id and instance_id become arrays of these names, in the shape of the hits.
        Where meshes have parts, `part_names` are those of all of them, one mesh after the other, and `part_id` counts
        through them.
    geometry_names, instance_names : sequence of str
        By the ids; they become arrays of texts.

    Raises
    ------
    ConfigError
        The path has another suffix, or the file cannot be written.
    """
    check_hits_path(path)
    arrays = {
        **{name: getattr(hits, name) for name in ("t", "u", "v", "prim_id", "geometry_id", "instance_id")},
        "geometry_names": np.array(geometry_names, np.str_),
        "instance_names": np.array(instance_names, np.str_),
    }
    shapes = hits.surface.shapes if hits.surface else ()
    parts = [shape.parts if isinstance(shape, Mesh) else () for shape in shapes]
    if any(parts):
        part_id, first_parts = hits.part_id, np.cumsum([0, *map(len, parts)], dtype=np.int32)
        arrays["part_id"] = np.where(part_id < 0, np.int32(-1), part_id + first_parts[hits.geometry_id])
        arrays["part_names"] = np.array([part.name for own in parts for part in own], np.str_)
    write_atomically(path, lambda file: np.savez(file, **arrays))


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


def write_exr(
    file: BinaryIO, channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, str] | None = None
) -> None:
    """Write an OpenEXR file: scan lines, ZIP compression.

    Parameters
    ----------
    file : binary file
        Open for writing; it can seek.
    channels : mapping of str to (height, width) float16, float32 or uint32
        By their names, such as ``"R"``, or ``"depth.Z"`` in the layer ``depth``. At least one, all of one shape.
    attributes : mapping of str to str, optional
        Notes in the header.

    Raises
    ------
    ConfigError
        OpenEXR is not installed.
    """
    openexr = import_openexr()
    head = {**(attributes or {}), "compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    # Copies of the arrays only where they are strided; the library puts objects of its own into the dictionary.
    openexr.File(head, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}).write(file)


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

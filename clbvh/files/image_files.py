"""Files of pictures, written completely or not at all, and text in pictures.

PNG and JPEG by imageio and Pillow, OpenEXR by the optional library of that name.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..support.files import check_target, write_atomically
from ..views.environment_files import import_openexr

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm")

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


def check_picture_path(path: str | os.PathLike[str]) -> Path:
    """Return the path; raise `ConfigError` unless a picture can be written there."""
    return check_target(path, "a picture", PICTURE_SUFFIXES)


def check_has_alpha(path: Path) -> None:
    """Raise `ConfigError` unless a file of this name can have a transparent background."""
    if path.suffix.lower() != ".png":
        raise ConfigError(f"{path}: a {path.suffix} file has no transparency; write a .png file")


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
    path = check_picture_path(path)
    if rgb.shape[2] == _CHANNELS_WITH_ALPHA:
        check_has_alpha(path)
    encoded = encode_picture(rgb, path.suffix.lower())
    write_atomically(path, lambda file: file.write(encoded))


def encode_picture(pixels: NDArray[Any], suffix: str, **options: Any) -> bytes:
    """Return the bytes of a picture file.

    Parameters
    ----------
    pixels : (height, width, 3) uint8
        PNG files may have an alpha channel, or be of (height, width) bool.
    suffix : str
        One of `PICTURE_SUFFIXES`.
    **options
        Of Pillow, in place of the usual ones.
    """
    if suffix == ".ppm":
        return encode_ppm(pixels)
    import imageio.v3  # here, because it takes 60 ms and pictures need not be files

    kind = suffix.replace("jpeg", "jpg")
    return imageio.v3.imwrite("<bytes>", pixels, plugin="pillow", extension=kind, **_PILLOW_OPTIONS[kind] | options)


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

"""Pictures that mesh files refer to, or hold: found, read and decoded.

Owns the limits: only regular files, only formats of pixels, and no picture larger than devices and memory take.
"""

from __future__ import annotations

import dataclasses
import io
import os
import warnings
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ...support.memory import check_memory
from ..appearance.material import MAX_TEXTURE_SIDE, Texture
from .file_mesh import Problems, read_named

# Of Pillow's formats those that are nothing but pixels; EPS, for example, would start another program.
_FORMATS = ("PNG", "JPEG", "BMP", "GIF", "TGA", "TIFF", "WEBP", "DDS", "PPM", "PCX", "SGI", "ICO", "JPEG2000")
_BYTES_PER_PIXEL = 16  # of the decoder, and twice our own
_WIDE_MODES = {"I;16": 65_535, "I;16B": 65_535, "I;16L": 65_535, "I": 65_535, "F": 1.0}


class TextureFiles:
    """The textures of one mesh file, each read once.

    Parameters
    ----------
    folder : Path
        Names are relative to it.
    problems : Problems
        Textures that cannot be read go there.
    """

    def __init__(self, folder: Path, problems: Problems) -> None:
        self._folder = folder
        self._problems = problems
        self._textures: dict[tuple[Path, bool, tuple[str, str]], Texture | None] = {}

    def read(
        self, name: str, *, is_srgb: bool, wrap: tuple[str, str] = ("repeat", "repeat"), folder: Path | None = None
    ) -> Texture | None:
        """Return a texture by the name of its file, None if it cannot be read."""
        path = find_file(self._folder if folder is None else folder, name)
        key = path, is_srgb, wrap
        if key not in self._textures:
            self._textures[key] = None
            with self._problems.drop(f"the texture {path.name}"):
                self._textures[key] = Texture(path.name, decode_image(read_named(path)), is_srgb, wrap)
        return self._textures[key]


def with_alpha(texture: Texture, alpha: NDArray[np.uint8] | int) -> Texture:
    """Return a texture with another alpha, (h, w) or one for all pixels; the same object if it has that already."""
    if (texture.pixels[..., 3] == alpha).all():
        return texture
    pixels = texture.pixels.copy()
    pixels[..., 3] = alpha
    return dataclasses.replace(texture, pixels=pixels)


def find_file(folder: Path, name: str) -> Path:
    """Return the path of a file that another one names.

    Names may have come from another machine: with backslashes, with a folder that is not there, or in letters of
    another case. The path is the first one that exists, or else the one in the name.
    """
    words = PurePosixPath(name.strip().strip('"').replace("\\", "/"))
    path = folder / words
    for candidate in (path, folder / words.name):
        if os.path.exists(candidate):  # noqa: PTH110 - also of a name that no file can have
            return candidate
        try:
            matches = [one for one in candidate.parent.iterdir() if one.name.lower() == candidate.name.lower()]
        except (OSError, ValueError):
            continue
        if matches:
            return matches[0]
    return path


def decode_image(data: bytes) -> NDArray[np.uint8]:
    """Return the pixels of a picture in the format of its file, (h, w, 4) uint8.

    Raises
    ------
    MeshError
        The format is unknown, or the picture is too large.
    Exception
        Whatever the decoder raises for damaged data.
    """
    from PIL import Image, UnidentifiedImageError  # takes 30 ms, and most meshes have no textures

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of unusual metadata, and of sizes that are checked here
        try:
            image = Image.open(io.BytesIO(data), formats=_FORMATS)
        except UnidentifiedImageError as error:
            raise MeshError("it is no picture in a format that is read, such as PNG or JPEG") from error
        with image:
            width, height = image.size
            if max(width, height) > MAX_TEXTURE_SIDE:
                raise MeshError(f"{width:,} x {height:,} pixels are more than {MAX_TEXTURE_SIDE:,} on a side")
            check_memory("a texture", width * height * _BYTES_PER_PIXEL, MeshError)
            if image.mode in _WIDE_MODES:
                shares = np.asarray(image, np.float64) / _WIDE_MODES[image.mode]
                grey = (np.clip(np.nan_to_num(shares), 0, 1) * 255 + 0.5).astype(np.uint8)
                return np.dstack((grey, grey, grey, np.full_like(grey, 255)))
            return np.array(image.convert("RGBA"))

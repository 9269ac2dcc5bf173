"""OpenEXR files: named channels of float16, float32 and uint32, by the library OpenEXR, which is optional."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, SceneError
from ...support.regular_file import read_errors_as, read_regular

_TYPES = (np.float16, np.float32, np.uint32)


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
        OpenEXR is not installed, or the channels have other shapes or types.
    """
    openexr = import_openexr()
    shapes = {pixels.shape for pixels in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
        raise ConfigError(
            f"the channels of an EXR file are arrays of one shape (height, width), not {shapes or 'none'}"
        )
    for name, pixels in channels.items():
        if pixels.dtype not in _TYPES:
            raise ConfigError(f"the channel {name!r} of an EXR file is float16, float32 or uint32, not {pixels.dtype}")
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

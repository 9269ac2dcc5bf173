"""The files that images are written to, checked before the work begins."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ...errors import ConfigError
from ...support.atomic_file import as_path, check_target
from ..formats.exr import import_openexr
from .save_exr import list_exr_channels
from .save_files import check_file_targets

IMAGES_SUFFIXES = (".exr", ".npz", ".png", ".ppm")

# One file for each channel.
FILES_SUFFIXES = (".png", ".ppm")


def check_images_path(path: str | os.PathLike[str], channels: Iterable[str] = ()) -> Path:
    """Return the path of images; raise `ConfigError` unless these channels can be written there."""
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix not in IMAGES_SUFFIXES:
        raise ConfigError(f"{target}: the name of images must end in {', '.join(IMAGES_SUFFIXES)}")
    names = tuple(channels)
    if suffix in FILES_SUFFIXES:
        check_file_targets(target, names)
        return target
    check_target(target)
    if suffix == ".exr":
        import_openexr()
        if names:
            list_exr_channels(names)
    return target

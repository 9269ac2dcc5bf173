"""Files of pictures and of hits, written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..support.atomic_file import as_path, check_target, write_atomically
from ..trace.hits.hits import Hits
from .formats.png import encode_png
from .formats.ppm import encode_ppm

PICTURE_SUFFIXES = (".ppm", ".png")
HITS_SUFFIX = ".npz"

_CHANNELS_WITH_ALPHA = 4


def check_picture_path(path: Path) -> None:
    """Raise `ConfigError` unless a picture can be written there; for checks before the work begins."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ConfigError(f"{path}: a picture's name must end in {' or '.join(PICTURE_SUFFIXES)}")
    check_target(path)


def check_has_alpha(path: Path) -> None:
    """Raise `ConfigError` unless a file of this name can have a transparent background."""
    if path.suffix.lower() == ".ppm":
        raise ConfigError(f"{path}: a PPM file has no transparency; write a PNG")


def check_hits_path(path: Path) -> None:
    """Raise `ConfigError` unless hits can be written there."""
    if path.suffix.lower() != HITS_SUFFIX:
        raise ConfigError(f"{path}: the name of a hits file must end in {HITS_SUFFIX}")
    check_target(path)


def write_picture(path: str | os.PathLike[str], rgb: NDArray[np.uint8]) -> None:
    """Write a picture as PPM (P6) or PNG, by the suffix of the name.

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
    return encode_ppm(rgb) if suffix == ".ppm" else encode_png(rgb)


def write_hits(path: Path, hits: Hits, geometry_names: Sequence[str], instance_names: Sequence[str]) -> None:
    """Write hits as a numpy archive, in which nothing is pickled.

    Parameters
    ----------
    path : Path
    hits : Hits
        Their t, u, v, prim_id, geometry_id and instance_id become arrays of these names, in the shape of the hits.
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
    write_atomically(path, lambda file: np.savez(file, **arrays))

"""Pictures of a surrounding light: Radiance and OpenEXR files as linear colours."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...support.regular_file import read_errors_as
from .exr import read_exr
from .radiance import read_radiance

ENVIRONMENT_SUFFIXES = (".hdr", ".exr")


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
        Another suffix, a file that cannot be read or is damaged, other channels, or a value that is not finite.
    ConfigError
        An ``.exr`` file, and OpenEXR is not installed.
    """
    with read_errors_as(SceneError, path):
        path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in ENVIRONMENT_SUFFIXES:
        raise SceneError(f"{path}: the name of an environment map must end in {' or '.join(ENVIRONMENT_SUFFIXES)}")
    pixels = read_radiance(path) if suffix == ".hdr" else _read_exr_colours(path)
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

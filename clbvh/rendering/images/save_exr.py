"""Images as one EXR file with a layer for each channel."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...support.atomic_file import write_atomically
from ..formats.exr import write_exr
from .channels import CHANNELS


def list_exr_channels(channels: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the EXR channels of each channel that has some; raise `ConfigError` if none has."""
    names = {channel: CHANNELS[channel].exr_names for channel in channels if CHANNELS[channel].exr_names}
    if not names:
        raise ConfigError("an EXR file has no 8-bit colours: ask for the channel colour in place of rgb")
    return names


def write_images_exr(path: Path, arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, NDArray[Any]]) -> None:
    """Write an EXR file.

    Parameters
    ----------
    path : Path
    arrays : mapping of channels to arrays
    facts : mapping of str to array
        Camera and names; they become attributes in JSON.
    """
    parts: dict[str, NDArray[Any]] = {}
    for channel, names in list_exr_channels(arrays).items():
        array = arrays[channel]
        # The same 32 bits: -1 becomes the largest number.
        array = array.view(np.uint32) if array.dtype == np.int32 else array.astype(np.float32, copy=False)
        parts.update(zip(names, np.moveaxis(array.reshape(*array.shape[:2], -1), 2, 0), strict=True))
    attributes = {name: json.dumps(values.tolist()) for name, values in facts.items()}
    write_atomically(path, lambda file: write_exr(file, parts, attributes))

"""PPM and PGM files of 8 and 16 bits: binary, without compression."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from .pixels import check_pixels

# Magic words by the number of channels.
_KINDS = {1: "P5", 3: "P6"}


def encode_ppm(pixels: NDArray[Any]) -> bytes:
    """Return the bytes of a PPM file, or of a PGM file for one channel.

    Parameters
    ----------
    pixels : (height, width) or (height, width, 1 or 3) uint8 or uint16
        16 bits have the high byte first.

    Raises
    ------
    ConfigError
        Another shape or type of pixels; the format has no alpha.
    """
    array = check_pixels(pixels)
    height, width, channel_count = array.shape
    if channel_count not in _KINDS:
        raise ConfigError(f"a PPM file has 1 or 3 channels, not {channel_count}: write a PNG file")
    head = f"{_KINDS[channel_count]}\n{width} {height}\n{np.iinfo(array.dtype).max}\n"
    return head.encode() + array.astype(array.dtype.newbyteorder(">"), copy=False).tobytes()

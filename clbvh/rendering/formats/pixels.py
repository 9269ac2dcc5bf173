"""The shapes and types of pixels that image files hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError

# Grey, grey and alpha, red green blue, and with alpha.
_CHANNEL_COUNTS = (1, 2, 3, 4)


def check_pixels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return pixels as a contiguous (height, width, channels) array of uint8 or uint16.

    Parameters
    ----------
    pixels : (height, width) or (height, width, 1 to 4) uint8 or uint16

    Raises
    ------
    ConfigError
        Another shape or type, or no pixel at all.
    """
    array = np.asarray(pixels)
    if array.dtype not in (np.uint8, np.uint16):
        raise ConfigError(f"the pixels of an image file are uint8 or uint16, not {array.dtype}")
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in _CHANNEL_COUNTS or array.size == 0:
        raise ConfigError(
            f"the pixels of an image file have the shape (height, width) or (height, width, 1 to 4), not {array.shape}"
        )
    return np.ascontiguousarray(array)

"""Colours in sRGB, as files and screens have them, and linear colours, which light adds up in.

IEC 61966-2-1, "Default RGB colour space - sRGB", 1999.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Weights of linear red, green and blue in the luminance (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

_LINEAR_END, _SLOPE, _OFFSET, _POWER = 0.04045, 12.92, 0.055, 2.4
_MAX_BYTE = 255
_STEPS = 1 << 16


def srgb_to_linear(colours: ArrayLike) -> NDArray[np.float64]:
    """Return linear colours of sRGB ones, both from 0 to 1 and of any shape.

    Examples
    --------
    >>> from clbvh.geometry.appearance.srgb import srgb_to_linear
    >>> srgb_to_linear([0, 0.5, 1]).round(4)
    array([0.   , 0.214, 1.   ])
    """
    values = np.clip(np.asarray(colours, np.float64), 0, 1)
    return np.where(values <= _LINEAR_END, values / _SLOPE, ((values + _OFFSET) / (1 + _OFFSET)) ** _POWER)


def linear_to_srgb(colours: ArrayLike) -> NDArray[np.float64]:
    """Return sRGB colours of linear ones, both from 0 to 1 and of any shape.

    Examples
    --------
    >>> from clbvh.geometry.appearance.srgb import linear_to_srgb
    >>> linear_to_srgb([0, 0.214, 1]).round(3)
    array([0. , 0.5, 1. ])
    """
    values = np.clip(np.asarray(colours, np.float64), 0, 1)
    curved = (1 + _OFFSET) * values ** (1 / _POWER) - _OFFSET
    return np.where(values <= _LINEAR_END / _SLOPE, values * _SLOPE, curved)


@cache
def _srgb_bytes() -> NDArray[np.uint8]:
    return to_bytes(linear_to_srgb(np.arange(_STEPS) / (_STEPS - 1)))


def linear_to_srgb_bytes(colours: ArrayLike) -> NDArray[np.uint8]:
    """Return sRGB colours from 0 to 255 of linear ones from 0 to 1; by a table of 65,536 steps, exact for 16 bits.

    Raises
    ------
    ValueError
        A number is NaN.
    """
    return _srgb_bytes()[_round(colours, _STEPS - 1).astype(np.uint16)]


def to_bytes(shares: ArrayLike) -> NDArray[np.uint8]:
    """Return numbers from 0 to 1 as bytes from 0 to 255, rounded; numbers beyond become the nearest of the two.

    Raises
    ------
    ValueError
        A number is NaN.
    """
    return _round(shares, _MAX_BYTE).astype(np.uint8)


def _round(shares: ArrayLike, most: int) -> NDArray[np.floating]:
    values = np.asarray(shares)
    if np.isnan(values).any():
        raise ValueError("a colour is not a number")
    return np.clip(values, 0, 1) * most + 0.5

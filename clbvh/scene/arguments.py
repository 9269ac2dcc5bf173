"""Arguments of a scene's methods: what they may be, and how messages quote wrong ones."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SceneError
from ..geometry.appearance.material import Material
from .instance import ALL_BITS, Colour

_MAX_SHOWN = 60  # characters of a wrong value in a message


def check_mask(mask: int) -> int:
    """Return the mask of instances; raise `SceneError` unless it is one."""
    if isinstance(mask, bool) or not isinstance(mask, Integral) or not 0 <= mask <= ALL_BITS:
        raise SceneError(f"a mask must be a whole number from 0 to 2^32 - 1, not {shorten(mask)}")
    return int(mask)


def check_colour(colour: ArrayLike | None) -> Colour | None:
    """Return the colour of instances, if there is one; raise `SceneError` unless it is a colour."""
    if colour is None:
        return None
    try:
        array = np.asarray(colour)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.shape != (3,) or array.dtype.kind not in "iuf" or not np.isfinite(array).all():
        raise SceneError(f"a colour must be three finite numbers: linear red, green and blue, not {shorten(colour)}")
    return float(array[0]), float(array[1]), float(array[2])


def check_material(material: Any) -> Material | None:
    """Return the material of instances, if there is one; raise `SceneError` unless it is a material."""
    if material is not None and not isinstance(material, Material):
        raise SceneError(f"a material must be a clbvh.Material, not {shorten(material)}")
    return material


def shorten(value: object) -> str:
    """Return a wrong value as a message quotes it."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."

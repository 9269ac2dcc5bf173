"""Vectors of three numbers as users give them: their type, and the check of a value."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError

Vector = tuple[float, float, float]


def is_vector(value: object) -> bool:
    """Return whether a value is three finite numbers."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.shape == (3,) and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())


def check_vector(name: str, value: object) -> None:
    """Raise `SceneError` unless a value is three finite numbers."""
    if not is_vector(value):
        raise SceneError(f"{name} must be three finite numbers, not {value!r}")


def as_vector(values: NDArray[np.float64]) -> Vector:
    """Return an array of three numbers as Python floats."""
    return float(values[0]), float(values[1]), float(values[2])

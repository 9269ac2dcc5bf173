"""Arrays as users give them: their checks, and their text in messages."""

from __future__ import annotations

from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError
from ...support.settings import Vector


def as_vector(values: Any) -> Vector:
    """Return three numbers as Python floats."""
    return float(values[0]), float(values[1]), float(values[2])


def read_array(name: str, values: ArrayLike, shape: tuple[int | EllipsisType, ...]) -> NDArray[np.float64]:
    """Return numbers as float64; raise `SceneError` unless they are finite and have this shape.

    Parameters
    ----------
    name : str
        The beginning of the message.
    values : array-like
    shape : tuple of int
        The first may be ``...``: any axes.
    """
    is_open = shape[0] is ...
    expected = f"an array of shape (..., {shape[-1]})" if is_open else " x ".join(map(str, shape)) + " numbers"
    try:
        array = np.asarray(values)
    except ValueError:
        raise SceneError(f"{name} must be {expected}, not rows of different lengths") from None
    if (array.shape[-1:] if is_open else array.shape) != shape[is_open:] or array.dtype.kind not in "iuf":
        shown = f"{array.dtype} of shape {array.shape}" if array.ndim else repr(values)[:60]
        raise SceneError(f"{name} must be {expected}, not {shown}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise SceneError(f"{name} must be finite")
    return array


def show_matrix(matrix: NDArray[np.float64]) -> str:
    """Return a small matrix on one line."""
    return "[" + ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in matrix) + "]"

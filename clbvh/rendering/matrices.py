"""Small matrices as users give them: the check of their shape and numbers, and their text in messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError


def read_matrix(name: str, values: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return a finite float64 matrix of this shape, or raise a `SceneError` that begins with the name."""
    try:
        matrix = np.asarray(values)
    except ValueError:  # rows of different lengths
        matrix = np.empty(0)
    if matrix.shape != shape or matrix.dtype.kind not in "iuf":
        raise SceneError(f"{name} must be {shape[0]} x {shape[1]} numbers, not {_describe(values)}")
    matrix = matrix.astype(np.float64)
    if not np.isfinite(matrix).all():
        raise SceneError(f"{name} must be finite, not {show_matrix(matrix)}")
    return matrix


def show_matrix(matrix: NDArray[np.float64]) -> str:
    """Return a small matrix on one line."""
    return "[" + ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in matrix) + "]"


def _describe(values: object) -> str:
    try:
        array = np.asarray(values)
    except ValueError:
        return "rows of different lengths"
    return f"{array.dtype} of shape {array.shape}" if array.ndim else repr(values)[:60]

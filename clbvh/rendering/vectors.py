"""Numbers, vectors, points and small matrices as users give them: their checks, and their text in messages."""

from __future__ import annotations

import math
from numbers import Real
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


def is_finite_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number that float64 can hold."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a longer integer
        return False


def read_points(name: str, values: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return points as (..., count) float64; raise `SceneError` unless they are finite numbers of that shape."""
    try:
        points = np.asarray(values)
    except ValueError:  # rows of different lengths
        points = np.empty(0)
    if points.ndim < 1 or points.shape[-1] != count or points.dtype.kind not in "iuf":
        raise SceneError(f"{name} must be an array of shape (..., {count}), not {np.shape(points)} {points.dtype}")
    points = points.astype(np.float64)
    if not np.isfinite(points).all():
        raise SceneError(f"{name} must be finite")
    return points


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

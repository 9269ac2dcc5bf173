"""Numbers, vectors, points and small matrices as users give them: their checks, and their text in messages."""

from __future__ import annotations

import math
from collections.abc import Callable
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
    return _read_array(name, values, f"an array of shape (..., {count})", lambda shape: shape[-1:] == (count,))


def read_matrix(name: str, values: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return a finite float64 matrix of this shape, or raise a `SceneError` that begins with the name."""
    return _read_array(name, values, f"{shape[0]} x {shape[1]} numbers", lambda found: found == shape)


def _read_array(
    name: str, values: ArrayLike, expected: str, fits: Callable[[tuple[int, ...]], bool]
) -> NDArray[np.float64]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise SceneError(f"{name} must be {expected}, not rows of different lengths") from None
    if not fits(array.shape) or array.dtype.kind not in "iuf":
        shown = f"{array.dtype} of shape {array.shape}" if array.ndim else repr(values)[:60]
        raise SceneError(f"{name} must be {expected}, not {shown}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise SceneError(f"{name} must be finite")
    return array


def show_matrix(matrix: NDArray[np.float64]) -> str:
    """Return a small matrix on one line."""
    return "[" + ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in matrix) + "]"

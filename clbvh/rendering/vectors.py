"""Numbers, vectors, points and small matrices as users give them: their checks, and their text in messages.

Vectors and numbers must not need numpy: the help of the command line knows them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from numbers import Real
from types import EllipsisType
from typing import TYPE_CHECKING, Any, TypeGuard

from ..errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]


def is_finite_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number that float64 can hold."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a longer integer
        return False


def is_vector(value: Any) -> bool:
    """Return whether a value is three finite numbers."""
    parts = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(parts, Sequence) or len(parts) != len("xyz"):
        return False
    # Numbers may be arrays without axes.
    return all(is_finite_number(part.tolist() if hasattr(part, "tolist") else part) for part in parts)


def check_vector(name: str, value: object) -> None:
    """Raise `SceneError` unless a value is three finite numbers."""
    if not is_vector(value):
        raise SceneError(f"{name} must be three finite numbers, not {value!r}")


def as_vector(values: Any) -> Vector:
    """Return three numbers as Python floats."""
    return float(values[0]), float(values[1]), float(values[2])


def read_vector(name: str, value: Any) -> Vector:
    """Return a user's vector as Python floats; raise `SceneError` unless it is three finite numbers."""
    check_vector(name, value)
    return as_vector(value)


def check_choice(name: str, value: object, choices: Iterable[str]) -> None:
    """Raise `SceneError` unless a value is one of several words."""
    if not isinstance(value, str) or value not in choices:
        raise SceneError(f"{name} must be one of {', '.join(choices)}, not {value!r}")


def read_array(name: str, values: ArrayLike, shape: tuple[int | EllipsisType, ...]) -> NDArray[np.float64]:
    """Return a user's numbers as float64; raise `SceneError` unless they are finite and have this shape.

    Parameters
    ----------
    name : str
        The beginning of the message.
    values : array-like
    shape : tuple of int
        The first may be ``...``: any axes.
    """
    import numpy as np  # imported here: vectors do not need it

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

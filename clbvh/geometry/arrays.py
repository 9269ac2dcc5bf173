"""Arrays as callers give them, checked one step at a time: an error names the first fault.

Owns the steps that meshes and spheres share. Must not know of either.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MeshError


def as_array(values: ArrayLike, name: str, shape: str = "(n, 3)") -> NDArray[Any]:
    """Return values as an array; raise `MeshError` where they are none, or where some are masked."""
    try:
        array = np.asarray(pick_xyz(values))
    except ValueError as error:
        raise MeshError(f"{name} must be an array of shape {shape}, but the rows differ in length: {error}") from error
    except TypeError as error:
        raise MeshError(f"{name} must be an array of shape {shape}: {error}") from error
    if has_masked_values(values):
        raise MeshError(f"{name} must be numbers, but some are masked: fill them, or leave their rows out")
    return array


def pick_xyz(values: Any) -> Any:
    """Return the columns x, y and z of a table, such as a `pandas.DataFrame`, that has them; else the values."""
    return values[["x", "y", "z"]] if hasattr(values, "columns") and {"x", "y", "z"} <= set(values.columns) else values


def check_numbers(array: NDArray[Any], name: str) -> None:
    """Raise `MeshError` unless the array's dtype is one of real numbers."""
    if not np.issubdtype(array.dtype, np.floating) and not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{name} must be numbers, not {array.dtype}")


def copy_as_float64(array: NDArray[Any]) -> NDArray[np.float64]:
    """Return a copy in C order; what is no number in float64 becomes NaN or an infinity."""
    with np.errstate(over="ignore", invalid="ignore"):  # a wider dtype, a signalling NaN
        return np.array(array, np.float64, order="C")


def has_masked_values(values: object) -> bool:
    """Return whether a value is an array of `numpy.ma` with masked values; does not import that module."""
    module = sys.modules.get("numpy.ma")
    return (
        module is not None and isinstance(values, getattr(module, "MaskedArray", ())) and bool(module.is_masked(values))
    )

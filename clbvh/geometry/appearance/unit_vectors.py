"""Vectors of any length to vectors of length 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEAST_SQUARE, _MOST_SQUARE = 1e-200, 1e200

# Unit vectors whose components were rounded to float32, or to six digits, have squares this near to 1.
_UNIT_TOLERANCE = 4e-6


def normalize(vectors: NDArray[np.number]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return vectors of length 1, and which of them have a direction.

    Parameters
    ----------
    vectors : (..., 3) float

    Returns
    -------
    unit : (..., 3) float32
        Those that are zero or not finite become (0, 0, 1).
    has_direction : (...) bool
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = np.einsum("...i,...i->...", vectors, vectors, dtype=np.float64)
        if (np.abs(squares - 1) < _UNIT_TOLERANCE).all():
            return vectors.astype(np.float32), np.ones(squares.shape, np.bool_)
        # The squares of the rest may underflow or overflow.
        has_direction = (squares > _LEAST_SQUARE) & (squares < _MOST_SQUARE)
        unit = (vectors / np.sqrt(squares)[..., None]).astype(np.float32)
        if not has_direction.all():
            odd = np.asarray(vectors[~has_direction], np.float64)
            scaled = odd / np.abs(odd).max(axis=-1, keepdims=True)
            scaled /= np.sqrt(np.einsum("ij,ij->i", scaled, scaled))[:, None]
            is_number = np.isfinite(scaled).all(axis=-1)
            unit[~has_direction] = np.where(is_number[:, None], scaled, (0, 0, 1))
            has_direction[~has_direction] = is_number
    return unit, has_direction

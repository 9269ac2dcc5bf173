"""The check of points that users give."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError


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

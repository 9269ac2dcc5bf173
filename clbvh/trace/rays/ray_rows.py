"""Rays in contiguous arrays, as compiled functions take them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled


class RayRows(NamedTuple):
    """Rays in contiguous arrays, as compiled functions take them.

    An array with a single row holds it for all rays: `row_step` tells how far the row of the next ray is.

    Attributes
    ----------
    origins, directions : (n, 3) or (1, 3), both float32 or both float64, the file's coordinates
    t_min, t_max : (n,) or (1,) float64, lengths of the direction
    """

    origins: NDArray[Any]
    directions: NDArray[Any]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]


@compiled
def row_step(rows):
    """Return the distance between the rows of consecutive rays: 0 if all rays share one."""
    return 1 if len(rows) > 1 else 0

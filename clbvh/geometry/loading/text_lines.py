"""Lines of numbers, as the text formats OBJ and OFF have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError


def read_coordinates(lines: list[bytes]) -> NDArray[np.float64]:
    """Return the first three numbers of each line, (n, 3); raise `MeshError` when there is no line."""
    if not lines:
        raise MeshError("the mesh has no vertices")
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2)

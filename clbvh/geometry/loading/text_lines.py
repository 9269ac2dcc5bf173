"""Lines of numbers, as the text formats OBJ and OFF have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError


def read_coordinates(lines: list[bytes]) -> NDArray[np.float64]:
    """Return the first three numbers of each line, (n, 3).

    Raises
    ------
    MeshError
        There is no line, or one has fewer than three numbers.
    """
    if not lines:
        raise MeshError("the mesh has no vertices")
    # numpy would skip an empty line, and all later faces would refer to the wrong vertices.
    empty = next((vertex for vertex, line in enumerate(lines) if not line.strip()), None)
    if empty is not None:
        raise MeshError(f"vertex {empty} has no coordinates")
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2, comments=None)

"""Unit vectors in 32 bits: an octahedron unfolded to a square, 16 bits a side.

Cigolle et al., "A survey of efficient representations for independent unit vectors", 2014. The error is at most 0.004
degrees, and cl/looks/looks.cl decodes them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..support.compiled import compiled

# The two lowest bits of a coordinate of 0 must not differ: an even number of steps has a middle.
_STEPS = 65534


def pack_normals(normals: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return (n,) uint32 for (n, 3) float32 of any length but 0; a zero becomes the z axis."""
    packed = np.empty(len(normals), np.uint32)
    _pack(normals, packed)
    return packed


def pack_tangents(tangents: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return (n,) uint32 for (n, 4) float32: a vector as above, and its fourth number's sign in the lowest bit.

    The bit was one of the x coordinate, so that the error may be twice as large.
    """
    is_negative = (tangents[:, 3] < 0).astype(np.uint32)
    return pack_normals(np.ascontiguousarray(tangents[:, :3])) & np.uint32(0xFFFFFFFE) | is_negative


@compiled
def _pack(normals, packed):
    for i in range(len(normals)):
        x, y, z = np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2])
        size = abs(x) + abs(y) + abs(z)
        if not size > 0.0:
            x, y, z, size = 0.0, 0.0, 1.0, 1.0
        x /= size
        y /= size
        if z < 0.0:
            folded_x = (1.0 - abs(y)) * (1.0 if x >= 0.0 else -1.0)
            y = (1.0 - abs(x)) * (1.0 if y >= 0.0 else -1.0)
            x = folded_x
        column = np.uint32(0.5 * (x + 1.0) * _STEPS + 0.5)
        row = np.uint32(0.5 * (y + 1.0) * _STEPS + 0.5)
        packed[i] = column | (row << np.uint32(16))

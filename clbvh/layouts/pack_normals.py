"""Unit vectors in 32 bits: an octahedron unfolded to a square, 16 bits a side.

Cigolle et al., "A survey of efficient representations for independent unit vectors", 2014. The error is at most 0.004
degrees, and cl/looks/looks.cl decodes them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops

_LOOPS = Loops("layouts/normals")


def pack_normals(normals: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return (n,) uint32 for (n, 3) float32 of any length but 0; a zero becomes the z axis."""
    packed = np.empty(len(normals), np.uint32)
    _LOOPS.pack_normals(normals, packed)
    return packed


def pack_tangents(tangents: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Return (n,) uint32 for (n, 4) float32: a vector as above, and its fourth number's sign in the lowest bit.

    The bit was one of the x coordinate, so that the error may be twice as large.
    """
    is_negative = (tangents[:, 3] < 0).astype(np.uint32)
    return pack_normals(np.ascontiguousarray(tangents[:, :3])) & np.uint32(0xFFFFFFFE) | is_negative

"""The angle of a triangle at one of its corners, and its normal there, for loops over faces."""

from __future__ import annotations

import math

from ..support.compiled import compiled


@compiled(error_model="numpy")
def measure_corner(vertices, faces, scale, face, corner):
    """Return a face's normal at a corner, not of length 1, its length, and the angle in radians.

    Without an area all are 0. `scale` is a power of two that brings the mesh to a size of about 1.
    """
    own, following, last = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    ux = (vertices[following, 0] - vertices[own, 0]) * scale
    uy = (vertices[following, 1] - vertices[own, 1]) * scale
    uz = (vertices[following, 2] - vertices[own, 2]) * scale
    vx = (vertices[last, 0] - vertices[own, 0]) * scale
    vy = (vertices[last, 1] - vertices[own, 1]) * scale
    vz = (vertices[last, 2] - vertices[own, 2]) * scale
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    largest = max(abs(nx), abs(ny), abs(nz))
    if largest == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    # Divided by the largest component first: the squares of a small triangle's normal could underflow.
    nx, ny, nz = nx / largest, ny / largest, nz / largest
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx, ny, nz, length, math.atan2(length * largest, ux * vx + uy * vy + uz * vz)

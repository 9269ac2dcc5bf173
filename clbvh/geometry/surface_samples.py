"""Random points on a surface of triangles: as many per area everywhere.

Osada, Funkhouser, Chazelle and Dobkin, "Shape Distributions", 2002, section 3.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError

# Random numbers for each point: one that chooses the triangle, and two for the place on it.
DRAWS_PER_POINT = 3


def sample_surface(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], draws: NDArray[np.float64], *, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points on triangles, and the normals of their triangles.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int32
    draws : (n, 3) float64
        Random numbers, at least 0 and less than 1. Point i depends on row i alone.
    name : str
        Of the surface, for messages.

    Returns
    -------
    points : (n, 3) float64
        Uniform over the area; triangles without area have none.
    normals : (n, 3) float64
        Of length 1, on the side from which a triangle's corners run counter-clockwise.

    Raises
    ------
    MeshError
        All triangles together have no area.
    """
    corner = vertices[faces[:, 0]]
    # Edges are halved, and scaled to at most 1: products of float64's largest and smallest numbers have no room in it.
    edges = np.stack([vertices[faces[:, end]] / 2 - corner / 2 for end in (1, 2)])
    longest = float(np.abs(edges).max())
    scaled = edges / longest if longest > 0 else edges
    crosses = np.cross(scaled[0], scaled[1])
    areas = np.sqrt((crosses**2).sum(axis=1))
    # Summed in the order of the faces, so that the same draws give the same points everywhere.
    sums = np.cumsum(areas)
    if not sums[-1] > 0:
        raise MeshError(f"{name}: nothing can be scattered on a surface without area")
    # The first sum above the drawn one belongs to a triangle with an area. The total itself is never drawn: a number
    # less than 1 times the total is rounded to less than the total.
    chosen = np.searchsorted(sums, draws[:, 0] * sums[-1], side="right")
    # Points of the parallelogram's other half are turned into the triangle.
    u, v = draws[:, 1, None], draws[:, 2, None]
    is_outside = u + v > 1
    u, v = np.where(is_outside, 1 - u, u), np.where(is_outside, 1 - v, v)
    points = corner[chosen] + 2 * (u * edges[0, chosen] + v * edges[1, chosen])
    return points, crosses[chosen] / areas[chosen, None]

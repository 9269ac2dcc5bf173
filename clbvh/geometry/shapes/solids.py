"""Plain solids, the parts of procedural shapes: vertices in float64 and faces in int64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError

Solid = tuple[NDArray[np.float64], NDArray[np.int64]]


def require_triangles(name: str, triangles: int, least: int) -> None:
    """Raise `ConfigError` unless there are enough triangles for the smallest mesh of the shape."""
    if triangles < least:
        raise ConfigError(f"the shape '{name}' needs at least {least} triangles, not {triangles}")


def cut_quads(
    a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64], d: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return two triangles per quad a, b, c, d, next to each other."""
    return np.column_stack((a, b, c, a, c, d)).reshape(-1, 3)


# The corners of a cube, x slowest, and its six sides seen from outside.
CUBE_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
CUBE_FACES = cut_quads(
    *np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]).T
)


def make_box(lower: ArrayLike, upper: ArrayLike) -> Solid:
    """Return a box along the axes between two corners, each (3,)."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    return np.where(CUBE_CORNERS < 0, lower, upper), CUBE_FACES


def make_beam(begin: ArrayLike, end: ArrayLike, width: float) -> Solid:
    """Return a beam of square cross-section between two (3,) points, of which none is straight above the other."""
    begin, end = np.asarray(begin, np.float64), np.asarray(end, np.float64)
    along = (end - begin) / 2
    side = np.cross(along, [0.0, 1.0, 0.0])
    side *= width / 2 / np.linalg.norm(side)
    upward = np.cross(side, along)
    upward *= width / 2 / np.linalg.norm(upward)
    return (begin + end) / 2 + CUBE_CORNERS @ np.array([along, upward, side]), CUBE_FACES


def make_lathe(centre: ArrayLike, radii: ArrayLike, heights: ArrayLike, sides: int) -> Solid:
    """Return a profile turned about the y axis, open at both ends.

    Parameters
    ----------
    centre : (3,) float
        The point on the axis at height 0.
    radii, heights : (k,) float
        The profile, from bottom to top.
    sides : int
        Quads around the axis; 2 (k - 1) sides triangles in all.
    """
    radii, heights = np.asarray(radii, np.float64), np.asarray(heights, np.float64)
    angle = np.arange(sides) * (2 * np.pi / sides)
    rings = np.empty((len(radii), sides, 3))
    rings[..., 0] = radii[:, None] * np.cos(angle)
    rings[..., 1] = heights[:, None]
    rings[..., 2] = radii[:, None] * np.sin(angle)
    ring, column = np.divmod(np.arange((len(radii) - 1) * sides), sides)
    next_column = (column + 1) % sides
    here, above = ring * sides, (ring + 1) * sides
    faces = cut_quads(here + column, above + column, above + next_column, here + next_column)
    return rings.reshape(-1, 3) + np.asarray(centre, np.float64), faces

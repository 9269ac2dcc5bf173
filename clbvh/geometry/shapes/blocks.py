"""Squares and cubes: what rooms are built of, by transforms."""

from __future__ import annotations

import numpy as np

from .solids import CUBE_FACES, Solid, cut_quads, make_box, require_triangles

_HALF = 0.5
_SQUARE_CORNERS = np.array([[-_HALF, 0, -_HALF], [-_HALF, 0, _HALF], [_HALF, 0, _HALF], [_HALF, 0, -_HALF]])
_SQUARE_FACES = cut_quads(*np.arange(4).reshape(4, 1))


def make_square(triangles: int, generator: np.random.Generator) -> Solid:
    """Return a square of side 1 that faces up, around the origin."""
    require_triangles("square", triangles, len(_SQUARE_FACES))
    return _SQUARE_CORNERS.copy(), _SQUARE_FACES


def make_cube(triangles: int, generator: np.random.Generator) -> Solid:
    """Return a cube of side 1 around the origin."""
    require_triangles("cube", triangles, len(CUBE_FACES))
    return make_box([-_HALF] * 3, [_HALF] * 3)

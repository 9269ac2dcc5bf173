"""Mountains over a square, down to a level shore: a height field."""

from __future__ import annotations

import math

import numpy as np

from .noise import fractal_noise
from .solids import Solid, cut_quads, require_triangles


def make_terrain(triangles: int, generator: np.random.Generator, *, height: float = 2.4) -> Solid:
    """Return the terrain; `make_shape` describes the options."""
    require_triangles("terrain", triangles, 2)
    columns = math.isqrt(triangles // 2)
    rows = triangles // (2 * columns)
    z, x = np.meshgrid(np.linspace(-5, 5, rows + 1), np.linspace(-5, 5, columns + 1), indexing="ij")
    ground = np.column_stack((x.ravel(), z.ravel()))

    # The plane is warped before the ridges are drawn on it, so ranges bend. The finest octave is four cells of the grid
    # wide; a larger mesh adds octaves and keeps the others.
    bend = np.column_stack([fractal_noise(ground * 0.25, generator, octaves=2) for _ in range(2)])
    rolling = fractal_noise(ground * 0.15, generator, octaves=3)
    octaves = max(int(math.log2(columns / 4)), 1)
    ridges = fractal_noise(ground * 0.2 + 0.35 * bend, generator, octaves=octaves, ridged=True)
    # Valleys are broad and calm, peaks narrow and rough; towards the border the land falls to a level shore.
    shore = np.prod(1 - (ground / 5) ** 8, axis=1)
    y = height * shore * (ridges**1.6 + 0.3 * rolling)

    vertices = np.column_stack((ground[:, 0], y, ground[:, 1]))
    row, column = np.divmod(np.arange(rows * columns), columns)
    corner = row * (columns + 1) + column
    below = corner + columns + 1
    return vertices, cut_quads(corner, below, below + 1, corner + 1)

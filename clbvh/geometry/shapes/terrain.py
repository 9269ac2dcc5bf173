"""Shapes with rough surfaces, a mountain range and a knotted tube, and the noise that makes them rough.

Gradient noise is summed over octaves: Ken Perlin, "An Image Synthesizer", 1985; the ridged sum after F. Kenton
Musgrave, in "Texturing and Modeling", 1994.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from .solids import Solid, cut_quads, require_triangles

_TABLE_SIZE = 256  # the period of the field along each axis, in units
_LACUNARITY = 2.03  # not quite 2, so that octaves do not share lattice points
_GAIN = 0.5
_SUM_OF_STRENGTHS = 1 / (1 - _GAIN)  # of endless octaves: finer ones do not change the height of a field
_CHUNK_POINTS = 1 << 14  # temporaries of a chunk stay in the cache


def fractal_noise(
    points: NDArray[np.float64], generator: np.random.Generator, *, octaves: int, ridged: bool = False
) -> NDArray[np.float64]:
    """Return a random field at points.

    Parameters
    ----------
    points : (n, d) float64, in units of the coarsest octave's lattice
        In two or three dimensions, or more.
    generator : numpy.random.Generator
        Chooses the field; drawn from.
    octaves : int
        Number of summed fields, each about twice as fine and half as strong as the one before.
    ridged : bool, optional
        Reflect each octave at zero, which makes sharp crests, and roughen the crests more than the valleys.

    Returns
    -------
    (n,) float64
        From about -1 to 1; ridged: from 0 to about 1.
    """
    dimensions = points.shape[1]
    order = generator.permutation(_TABLE_SIZE)
    slopes = generator.normal(size=(_TABLE_SIZE, dimensions))
    slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)
    shifts = generator.uniform(0, _TABLE_SIZE, (octaves, dimensions))
    strengths = _GAIN ** np.arange(octaves)

    total = np.empty(len(points))
    for begin in range(0, len(points), _CHUNK_POINTS):
        chunk = points[begin : begin + _CHUNK_POINTS]
        value = np.zeros(len(chunk))
        roughness = np.ones(len(chunk))
        for octave in range(octaves):
            field = _gradient_noise(chunk * _LACUNARITY**octave + shifts[octave], order, slopes)
            if ridged:
                field = (1 - np.abs(field)) ** 2 * roughness
                roughness = np.clip(2 * field, 0, 1)
            value += strengths[octave] * field
        total[begin : begin + _CHUNK_POINTS] = value
    return total / _SUM_OF_STRENGTHS


def _gradient_noise(
    points: NDArray[np.float64], order: NDArray[np.int64], slopes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return one octave at (n, d) points: random slopes at the lattice points, blended in between."""
    dimensions = points.shape[1]
    floor = np.floor(points)
    cell = floor.astype(np.int64)
    inside = points - floor
    # Perlin's quintic ("Improving Noise", 2002): no creases at the borders of cells.
    blend = inside**3 * (inside * (inside * 6 - 15) + 10)
    field = np.zeros(len(points))
    for corner in product((0, 1), repeat=dimensions):
        slot = np.zeros(len(points), dtype=np.int64)
        weight = np.ones(len(points))
        for axis, step in enumerate(corner):
            slot = order[(slot + cell[:, axis] + step) % _TABLE_SIZE]
            weight *= blend[:, axis] if step else 1 - blend[:, axis]
        slope = slopes[slot]
        height = np.zeros(len(points))
        for axis, step in enumerate(corner):
            height += slope[:, axis] * (inside[:, axis] - step)
        field += weight * height
    # A slope of 1 in a unit cell reaches no further than half its diagonal.
    return field * (2 / np.sqrt(dimensions))


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


def make_knot(
    triangles: int,
    generator: np.random.Generator,
    *,
    turns: float = 2,
    loops: float = 3,
    thickness: float = 0.5,
    strands: float = 4,
    crossings: float = 44,
    relief: float = 0.2,
    roughness: float = 0.03,
) -> Solid:
    """Return the knot; `make_shape` describes the options."""
    for key, value in {"turns": turns, "loops": loops, "strands": strands, "crossings": crossings}.items():
        if value != int(value) or value < 1:
            raise ConfigError(f"the option '{key}' of the shape 'knot' must be a whole number from 1, not {value!r}")
    if math.gcd(int(turns), int(loops)) != 1:
        raise ConfigError(f"a knot's turns and loops have no common divisor, but {turns} and {loops} do")
    # With these proportions the cells of a plain knot are about square: its curve is nine times as long as a turn
    # around the tube.
    require_triangles("knot", triangles, 2 * 9 * 3**2)
    across = math.isqrt(triangles // (2 * 9))
    along = triangles // (2 * across)

    # The curve, and a frame across it: the normal of the torus that it lies on, which closes with the curve.
    t = np.arange(along) * (2 * np.pi / along)
    radial = np.column_stack((np.cos(turns * t), np.sin(turns * t), np.zeros(along)))
    onward = np.column_stack((-np.sin(turns * t), np.cos(turns * t), np.zeros(along)))
    axial = np.array([0.0, 0.0, 1.0])
    reach, lift = (2 + 0.9 * np.cos(loops * t))[:, None], 0.9 * np.sin(loops * t)[:, None]
    curve = reach * radial + lift * axial
    normal = np.cos(loops * t)[:, None] * radial + np.sin(loops * t)[:, None] * axial
    tangent = loops * (-lift * radial + (reach - 2) * axial) + turns * reach * onward
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, normal)

    # The braid: two families of strands wind in opposite senses; where they cross, they take turns on top.
    angle = np.arange(across) * (2 * np.pi / across)
    around, forth = strands * angle[None, :], crossings * t[:, None]
    over = 0.35 * np.cos(around)
    braid = np.maximum(_strand(around + forth) + over, _strand(around - forth) - over)
    radius = thickness * (1 + relief * np.maximum(braid - 0.7, -0.55))

    outward = np.cos(angle)[None, :, None] * normal[:, None, :] + np.sin(angle)[None, :, None] * side[:, None, :]
    surface = curve[:, None, :] + radius[..., None] * outward
    wear = fractal_noise(surface.reshape(-1, 3) * (1.5 / thickness), generator, octaves=3).reshape(radius.shape)
    surface += (thickness * roughness * wear)[..., None] * outward

    # The grid closes in both directions.
    row, column = np.divmod(np.arange(along * across), across)
    next_row, next_column = (row + 1) % along, (column + 1) % across
    faces = cut_quads(
        row * across + column,
        row * across + next_column,
        next_row * across + next_column,
        next_row * across + column,
    )
    return surface.reshape(-1, 3), faces


def _strand(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of strands that lie at each multiple of 2 pi: rounded, from 1 down to below 0 between them."""
    distance = np.abs((phase + np.pi) % (2 * np.pi) - np.pi)
    return np.cos(distance * 0.62)

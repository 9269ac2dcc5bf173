"""Smooth random fields for the procedural shapes: gradient noise, summed over octaves.

Ken Perlin, "An Image Synthesizer", 1985; the ridged sum after F. Kenton Musgrave, in "Texturing and Modeling", 1994.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

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

"""The distance between neighbours in a cloud of points, from which spheres of a sensible size are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Points whose neighbours are looked for, spread over the cloud, and about as many as bound the distance.
_SEEDS, _SOME = 32, 50_000

# The neighbour that counts. This share of its distance is about the spacing on a surface, in rows or at random: spheres
# at random leave 4 % of a surface open, and half as large ones a fifth.
_NEIGHBOUR, _SHARE = 6, 0.75

# Of a lone point, or of points that are all in one place.
_LEAST = 1e-6


def find_point_radius(points: NDArray[np.float64]) -> float:
    """Return a radius by which spheres around (n, 3) finite points look like a surface: the median over some points."""
    seeds = points[np.linspace(0, len(points) - 1, min(_SEEDS, len(points))).astype(np.int64)]
    rank = min(_NEIGHBOUR, len(points) - 1)
    some, columns = points[:: -(-len(points) // _SOME)], [np.ascontiguousarray(column) for column in points.T]
    distances = []
    for seed in seeds:
        # Among some of the points, the neighbour is no nearer than among all: those farther away do not matter.
        limit = _find_distance(some, seed, rank) if len(some) > rank else np.inf
        near = np.flatnonzero(np.abs(columns[0] - seed[0]) <= limit)
        for column, middle in zip(columns[1:], seed[1:], strict=True):
            near = near[np.abs(column[near] - middle) <= limit]
        distances.append(_find_distance(points[near], seed, rank))
    radius = _SHARE * float(np.median(distances))
    if radius > 0:
        return radius
    size = float(np.ptp(points, axis=0).max())
    return _LEAST * size if size > 0 else 1.0


def _find_distance(points: NDArray[np.float64], seed: NDArray[np.float64], rank: int) -> float:
    """Return how far the point of a rank, counted from 0, is from a seed."""
    squares = np.square(points - seed).sum(axis=1)
    return float(np.sqrt(np.partition(squares, rank)[rank]))

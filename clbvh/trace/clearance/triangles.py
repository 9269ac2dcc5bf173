"""The exact distance of two triangles, for those of which cl/triangles/measure.cl cannot tell in float64.

Triangles are closed sets of points: a common point of any kind is a touch. They may be degenerate to a segment or a
point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from operator import mul
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

_Vector: TypeAlias = tuple[int, int, int]

# A limit below all squared distances of triangles apart, and what stands for one that is rounded to 0: those of
# cl/triangles/measure.cl.
TOUCH, APART = 2.0**-1000, 2.0**-999

# The corners of the vertices, the edges and the face.
_PIECES = ((0,), (1,), (2,), (0, 1), (1, 2), (2, 0), (0, 1, 2))
_MOST_DIRECTIONS = 3


def measure_exactly(corners: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Return the distance of two triangles, rounded once, and a closest point of each; 0 only if they touch.

    Parameters
    ----------
    corners : (6, 3) float64
        Of one, then of the other.

    Returns
    -------
    distance : float
    points : (2, 3) float64

    Notes
    -----
    In integers of any length: for each pair of a vertex, an edge or the face of either, the point where the squared
    distance of their planes, lines or points is least, by Cramer's rule, if it is within both.
    """
    ratios = [value.as_integer_ratio() for value in corners.ravel().tolist()]
    unit = max(below for _, below in ratios)  # a power of two, as all are
    x, y, z = [[above * (unit // below) for above, below in ratios[axis::3]] for axis in range(3)]
    points = list(zip(x, y, z, strict=True))
    squared, least, feet = 0, 0, []  # the squared distance is squared / least
    for one, other in product(_PIECES, _PIECES):
        count = len(one) - 1
        if count + len(other) - 1 > _MOST_DIRECTIONS:
            continue
        start, end = points[one[0]], points[3 + other[0]]
        along = [_minus(points[corner], start) for corner in one[1:]]
        along += [_minus(end, points[3 + corner]) for corner in other[1:]]
        way = _minus(start, end)
        matrix, right = [[_dot(x, y) for y in along] for x in along], [-_dot(x, way) for x in along]
        below = _determinant(matrix)
        if below == 0:
            continue  # parallel: a smaller piece is as close
        shares = [
            _determinant([[*x[:k], y, *x[k + 1 :]] for x, y in zip(matrix, right, strict=True)])
            for k in range(len(right))
        ]
        if min(shares, default=0) < 0 or max(sum(shares[:count]), sum(shares[count:])) > below:
            continue
        above = below * _dot(way, way) - sum(map(mul, shares, right))
        if least == 0 or above * least < squared * below:
            squared, least = above, below
            steps = list(zip(shares, along, strict=True))
            feet = [
                [below * start[axis] + sum(share * way[axis] for share, way in steps[:count]) for axis in range(3)],
                [below * end[axis] - sum(share * way[axis] for share, way in steps[count:]) for axis in range(3)],
            ]
        if squared == 0:
            break
    return _root_of(squared, least * unit * unit), np.array(
        [[value / (least * unit) for value in foot] for foot in feet]
    )


def _minus(one: _Vector, other: _Vector) -> _Vector:
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


def _dot(one: Sequence[int], other: Sequence[int]) -> int:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _determinant(m: Sequence[Sequence[int]]) -> int:
    """Return the determinant of a matrix of at most 3 x 3; 1 of none."""
    if len(m) < 2:
        return m[0][0] if m else 1
    if len(m) == 2:
        return m[0][0] * m[1][1] - m[0][1] * m[1][0]
    minors = [m[1][i] * m[2][j] - m[1][j] * m[2][i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return _dot(m[0], minors)


def _root_of(above: int, below: int) -> float:
    """Return the root of a fraction whose square may be out of the range of float64."""
    half = (below.bit_length() - above.bit_length()) // 2
    ratio = (above << 2 * max(half, 0)) / (below << 2 * max(-half, 0))
    return math.ldexp(math.sqrt(ratio), -half)

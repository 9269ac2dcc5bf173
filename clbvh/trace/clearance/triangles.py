"""Two triangles: their distance, and whether they touch; exact where float64 cannot tell.

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

from ...support.compiled import compiled
from ...support.loop_functions import add_scaled, cross, dot, subtract

# A determinant of three differences of corners, computed in float64, is wrong by less than this share of the product
# of their largest components, and less than the other number. Each of its six products has at most 3 roundings of
# differences, 2 of multiplications and 5 of sums, of 2^-53 each: together less than 60 of them. See Shewchuk,
# "Adaptive precision floating-point arithmetic and fast robust geometric predicates", 1997.
_DETERMINANT_ERROR = 2.0**-46
_UNDERFLOW = 2.0**-1000

# Triangles farther apart than this share of their size touch only if determinants say so for certain.
#
# Proof: take their size to be 1 to 2, so that differences are below 4. If they touch other than by a vertex or two
# edges, an edge pq of one pierces the other one, T, in x. Let one of the five determinants be uncertain: at most 2^-45
# times the product of its rows. If it is that of p and the plane of T, then p is h <= 2^-43 l^2 / n above T, with l the
# longest edge of T and n twice its area, and x is at most r <= n / 2l from an edge of T. As xp stays as low as p, it
# ends above T or passes an edge, at most h away. So the distance of the pieces, vertices to faces and edges to edges,
# is at most sqrt(h r) < 2^-20. If it is that of pq and an edge e of T, look along e: the parallelogram of p and q seen
# from e is at most d = 2^-41. Either pq looks shorter than sqrt(d), and p is that close to T; or its line passes e at
# sqrt(d), and with the same argument so close a piece of T passes p, q, or an edge, at most sqrt(2 d) = 2^-20 away.
_CERTAIN_SHARE = 2.0**-18

# Squared distances below this, where the scene is of size 1, lose digits to underflow.
_LEAST_SQUARED = 2.0**-600

# Room for the rounding of a squared distance of boxes.
_SHRINK = 1.0 - 2.0**-50

_Vector: TypeAlias = tuple[int, int, int]

# A limit below all squared distances of triangles apart, and what stands for one that is rounded to 0.
TOUCH, APART = 2.0**-1000, 2.0**-999

# The corners of the vertices, the edges and the face.
_PIECES = ((0,), (1,), (2,), (0, 1), (1, 2), (2, 0), (0, 1, 2))
_MOST_DIRECTIONS = 3


@compiled
def measure_triangles(a, b, limit):
    """Return the squared distance of two triangles, and whether it may be 0 for all that float64 can tell.

    Infinity is returned for a distance that is not below the limit; 0 only for triangles that touch for certain.

    Parameters
    ----------
    a, b : three corners each
        In a unit that makes the scene about 1.
    limit : float64
        Squared distance; `TOUCH` where only touches are looked for.
    """
    gap = _squared_gap(a, b, 0) + _squared_gap(a, b, 1) + _squared_gap(a, b, 2)
    if gap * _SHRINK >= limit:
        return np.inf, False
    may_touch = gap == 0.0
    if may_touch:
        sides_of_b, sides_of_a = _find_sides(a, b), _find_sides(b, a)
        may_touch = not (_is_one_sided(sides_of_b) or _is_one_sided(sides_of_a))
        if may_touch and (_pierces(b, sides_of_b, a) or _pierces(a, sides_of_a, b)):
            return 0.0, False
    if not may_touch and limit <= TOUCH:
        return np.inf, False
    squared = _measure_pieces(a, b)
    if not may_touch:
        squared = max(squared, APART)
    else:
        size = 0.0
        for one in (a[1], a[2], b[0], b[1], b[2]):
            size = max(size, _largest(subtract(one, a[0])))
        if squared <= max(_CERTAIN_SHARE * _CERTAIN_SHARE * size * size, _LEAST_SQUARED):
            return squared, True
    return squared if squared < limit else np.inf, False


@compiled
def _squared_gap(a, b, axis):
    gap = max(
        max(min(a[0][axis], a[1][axis], a[2][axis]) - max(b[0][axis], b[1][axis], b[2][axis]), 0.0),
        min(b[0][axis], b[1][axis], b[2][axis]) - max(a[0][axis], a[1][axis], a[2][axis]),
    )
    return gap * gap


@compiled
def _largest(vector):
    return max(abs(vector[0]), abs(vector[1]), abs(vector[2]))


@compiled
def _side(base, one, two, three):
    """Return the sign of the determinant of three points seen from a fourth; 0 where it is not certain."""
    x, y, z = subtract(one, base), subtract(two, base), subtract(three, base)
    volume = dot(cross(x, y), z)
    error = _DETERMINANT_ERROR * _largest(x) * _largest(y) * _largest(z) + _UNDERFLOW
    return 1 if volume > error else (-1 if volume < -error else 0)


@compiled
def _find_sides(t, corners):
    """Return on which side of the plane of a triangle each of three corners is."""
    return (
        _side(t[0], t[1], t[2], corners[0]), _side(t[0], t[1], t[2], corners[1]), _side(t[0], t[1], t[2], corners[2])
    )  # fmt: skip


@compiled
def _is_one_sided(sides):
    return sides[0] != 0 and sides[0] == sides[1] == sides[2]


@compiled
def _pierces(corners, sides, t):
    """Return whether an edge of a triangle passes through another one for certain, given the sides of its corners."""
    for first in range(3):
        second = (first + 1) % 3
        if sides[first] * sides[second] < 0:
            p, q = corners[first], corners[second]
            side = _side(t[0], t[1], p, q)
            if side != 0 and side == _side(t[1], t[2], p, q) and side == _side(t[2], t[0], p, q):
                return True
    return False


@compiled
def _measure_pieces(a, b):
    """Return the least squared distance of vertices to faces and of edges to edges: that of triangles apart.

    See Ericson, "Real-time collision detection", 2005, 5.1.
    """
    squared = min(_above_face(a, b), _above_face(b, a))
    for i in range(3):
        for j in range(3):
            squared = min(squared, _between_edges(a[i], a[(i + 1) % 3], b[j], b[(j + 1) % 3]))
    return squared


@compiled(error_model="numpy")
def _above_face(t, corners):
    """Return the least squared distance of three corners from where they are right above or below a triangle."""
    edges = subtract(t[1], t[0]), subtract(t[2], t[1]), subtract(t[0], t[2])
    normal = cross(edges[0], edges[1])
    least = np.inf
    for corner in corners:
        from_a, from_b, from_c = subtract(t[0], corner), subtract(t[1], corner), subtract(t[2], corner)
        a = dot(cross(from_b, edges[1]), normal)
        b = dot(cross(from_c, edges[2]), normal)
        c = dot(cross(from_a, edges[0]), normal)
        total = a + b + c
        if a >= 0.0 and b >= 0.0 and c >= 0.0 and total > 0.0:
            # To the foot itself, which is in the triangle also where rounding has turned the normal of a thin one.
            away = add_scaled(add_scaled(from_a, b / total, edges[0]), -c / total, edges[2])
            least = min(least, dot(away, away))
    return least


@compiled(error_model="numpy")
def _between_edges(p, q, r, s):
    """Return the squared distance of two segments; either may be a point."""
    one, other, way = subtract(q, p), subtract(s, r), subtract(r, p)
    normal = cross(one, other)
    # Of the normal, not of dot products, which cancel for edges that are nearly parallel.
    along = _share(dot(cross(way, other), normal), dot(normal, normal))
    across = _share(-dot(add_scaled(way, -along, one), other), dot(other, other))
    along = _share(dot(add_scaled(way, across, other), one), dot(one, one))
    away = add_scaled(add_scaled(way, across, other), -along, one)
    return dot(away, away)


@compiled(error_model="numpy")
def _share(part, whole):
    return min(max(part / whole, 0.0), 1.0) if whole > 0.0 else 0.0


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

"""The point of a triangle and of an ellipsoid that is nearest to a point, in float64."""

from __future__ import annotations

import numpy as np

from ...support.compiled import compiled
from ...support.triples import cross, dot, subtract

# Where the halving of an interval has come down to the pole.
_POLE = 1e-300


@compiled
def nearest_on_triangle(a, b, c):
    """Return the point of a triangle that is nearest to zero, as a tuple; the corners are tuples of 3 float64.

    The foot on the plane if it is inside, else the nearest point of the edges: slow, and nothing to get wrong.
    """
    nearest = _nearest_on_edge(a, b)
    for other in (_nearest_on_edge(b, c), _nearest_on_edge(c, a)):
        if dot(other, other) < dot(nearest, nearest):
            nearest = other
    ab, ac = subtract(b, a), subtract(c, a)
    normal = cross(ab, ac)
    square = dot(normal, normal)
    if square > 0.0:
        share = dot(normal, a) / square
        foot = (share * normal[0], share * normal[1], share * normal[2])
        to_a, to_b, to_c = subtract(a, foot), subtract(b, foot), subtract(c, foot)
        if (
            dot(normal, cross(to_a, to_b)) >= 0.0
            and dot(normal, cross(to_b, to_c)) >= 0.0
            and dot(normal, cross(to_c, to_a)) >= 0.0
        ):
            nearest = foot
    return nearest


@compiled
def _nearest_on_edge(a, b):
    way = subtract(b, a)
    square = dot(way, way)
    share = min(max(-dot(a, way) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return a[0] + share * way[0], a[1] + share * way[1], a[2] + share * way[2]


@compiled
def nearest_on_ellipsoid(axes, point, nearest):
    """Write the point of the surface of an ellipsoid that is nearest to a point.

    Parameters
    ----------
    axes : (3,) float64
        Half the lengths of the axes, which are the coordinate axes; above 0, in any order.
    point : (3,) float64
        Inside or outside, or on the surface.
    nearest : (3,) float64, written

    Notes
    -----
    The nearest point x is where ``point - x`` is along the normal: ``x_i = a_i^2 p_i / (s + a_i^2)`` with the greatest
    s for which x is on the surface. The sum of the squares of ``x_i / a_i`` falls with s, so halving an interval finds
    it (Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013). If the point is on the
    plane across the shortest axis, and near the centre, the sum stays below 1 down to the pole, where s is minus the
    square of that axis, and the rest of the way goes along it.
    """
    shortest = min(axes[0], axes[1], axes[2])
    # In units of the shortest axis, and s from the pole on, so that float64 has all digits of it there.
    low, high = 0.0, 1.0
    for axis in range(3):
        high += (axes[axis] / shortest) * abs(point[axis] / shortest)
    while True:
        middle = low + (high - low) / 2.0
        if middle in (low, high):
            break
        if _sum_of_squares(axes, point, shortest, middle) > 1.0:
            low = middle
        else:
            high = middle
    rest = 1.0
    for axis in range(3):
        share = _share(axes[axis], point[axis], shortest, high)
        nearest[axis] = share * axes[axis]
        rest -= share * share
    if high <= _POLE:
        for axis in range(3):
            if axes[axis] == shortest:
                nearest[axis] = np.sqrt(max(rest, 0.0)) * axes[axis]
                break


@compiled
def _share(half_axis, coordinate, shortest, s):
    """Return ``x_i / a_i``."""
    stretch = half_axis / shortest
    return stretch * (coordinate / shortest) / (s + (stretch - 1.0) * (stretch + 1.0))


@compiled
def _sum_of_squares(axes, point, shortest, s):
    one = _share(axes[0], point[0], shortest, s)
    other = _share(axes[1], point[1], shortest, s)
    third = _share(axes[2], point[2], shortest, s)
    return one * one + other * other + third * third

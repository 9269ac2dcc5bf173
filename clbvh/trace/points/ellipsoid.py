"""The closest point of an ellipsoid, in float64: a sphere under an affine map.

The point on the surface that is closest to y is at x with ``x_i = l_i^2 y_i / (t + l_i^2)``, in the coordinates of the
axes, whose half lengths are l. The one t above -l_min^2 for which x is on the surface is found by Newton's method
(Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013, with bisection).

With ``t = l_min^2 (s - 1)`` the shares ``x_i / l_i`` are ``pulls_i / (s + above_i)``, and s > 0 keeps its digits where
it is small. One over the length of the shares is concave in s. So Newton's steps, which begin where a share alone is 1,
never pass the s where that length is 1 (More and Sorensen, "Computing a trust region step", 1983).
"""

from __future__ import annotations

import numpy as np

from ...support.compiled import compiled

# Most steps; five to seven are usual.
_STEPS = 64


@compiled(error_model="numpy")
def find_shares(position, lengths, shares):
    """Write the closest point of an ellipsoid around zero, in half lengths of its axes.

    Parameters
    ----------
    position : (3,) float64
        Along the axes, not negative.
    lengths : (3,) float64
        Half lengths of the axes, above 0; squares of their ratios to each other and to the position are in float64.
    shares : (3,) float64, written
        On the unit sphere, not negative. At equal distance, the one off the plane across the first shortest axis.
    """
    least = min(lengths[0], lengths[1], lengths[2])
    shift = 0.0
    for axis in range(3):
        shift = max(shift, _pull(position, lengths, least, axis) - _above(lengths, least, axis))
    squared = _write_shares(position, lengths, least, shift, shares)
    for _ in range(_STEPS):
        if not squared > 1.0:
            break
        slope = 0.0
        for axis in range(3):
            if shares[axis] > 0.0:
                slope += shares[axis] * shares[axis] / (shift + _above(lengths, least, axis))
        further = shift + (np.sqrt(squared) - 1.0) * squared / slope
        if not further > shift:
            break
        shift = further
        squared = _write_shares(position, lengths, least, shift, shares)
    if shift == 0.0 and squared < 1.0:
        # From the middle of the ellipsoid.
        for axis in range(3):
            if lengths[axis] == least:
                shares[axis] = np.sqrt(1.0 - squared)
                return
    size = np.sqrt(squared)
    for axis in range(3):
        shares[axis] /= size


@compiled(error_model="numpy")
def _pull(position, lengths, least, axis):
    return lengths[axis] / least * (position[axis] / least)


@compiled(error_model="numpy")
def _above(lengths, least, axis):
    ratio = lengths[axis] / least
    return (ratio - 1.0) * (ratio + 1.0)


@compiled(error_model="numpy")
def _write_shares(position, lengths, least, shift, shares):
    """Write the shares for a shift, and return the sum of their squares."""
    squared = 0.0
    for axis in range(3):
        pull = _pull(position, lengths, least, axis)
        # A pull of zero is one also where the denominator is zero.
        shares[axis] = pull / (shift + _above(lengths, least, axis)) if pull > 0.0 else 0.0
        squared += shares[axis] * shares[axis]
    return squared

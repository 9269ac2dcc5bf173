"""The coordinates u and v of a point on a sphere, from which location and normal follow.

With the object's z axis as the axis of the sphere, u is the azimuth from the x axis towards the y axis in turns, from 0
to below 1, and v the angle from the z axis in half turns, from 0 to 1. In float64 a point comes back to within 1e-15 of
the radius, wherever it is: next to the poles, where u is coarse, the circles around the axis are as small.
"""

from __future__ import annotations

import math

from ...support.compiled import compiled

_TURN = 2.0 * math.pi


@compiled
def sphere_uv(x, y, z):
    """Return (u, v) of a point on a sphere.

    Parameters
    ----------
    x, y, z : float64
        From the centre to the point, of about length 1; the length does not matter.
    """
    # Turns -0.0 into 0.0, which is half a turn away for atan2.
    u = math.atan2(y + 0.0, x + 0.0) / _TURN
    if u < 0.0:
        u += 1.0
    # An angle just below zero is rounded up to a full turn.
    if u >= 1.0:
        u = 0.0
    return u, math.atan2(math.sqrt(x * x + y * y), z) / math.pi


@compiled
def sphere_point(u, v):
    """Return (x, y, z): the unit vector from the centre to the point (u, v), the sphere's outer normal.

    Sines and cosines are taken of an eighth of a turn at most, measured from the nearest axis, which rounds nothing: so
    the points on the axes are exact.
    """
    quarter = math.floor(4.0 * u + 0.5)
    angle = _TURN * (u - 0.25 * quarter)
    sine, cosine = math.sin(angle), math.cos(angle)
    if quarter == 1:
        sine, cosine = cosine, -sine
    elif quarter == 2:
        sine, cosine = -sine, -cosine
    elif quarter == 3:
        sine, cosine = -cosine, sine
    if v < 0.25:
        radius, z = math.sin(math.pi * v), math.cos(math.pi * v)
    elif v <= 0.75:
        radius, z = math.cos(math.pi * (0.5 - v)), math.sin(math.pi * (0.5 - v))
    else:
        radius, z = math.sin(math.pi * (1.0 - v)), -math.cos(math.pi * (1.0 - v))
    return cosine * radius, sine * radius, z

"""Where a ray crosses a sphere, and the coordinates u and v of a point on it, from which location and normal follow.

With the object's z axis as the axis of the sphere, u is the azimuth from the x axis towards the y axis in turns, from 0
to below 1, and v the angle from the z axis in half turns, from 0 to 1. In float64 a point comes back to within 1e-15 of
the radius, wherever it is: next to the poles, where u is coarse, the circles around the axis are as small.

Device code decides which spheres are hit, in float32. The functions here compute where, from the spheres as they are
given. All lengths are scaled by powers of two first, which rounds nothing, so spheres may have any size.
"""

from __future__ import annotations

import math

from ...support.compiled import compiled
from ...support.loop_functions import exponent_of, times_power_of_two

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


@compiled(error_model="numpy")
def sphere_crossing(origin, direction, centre, radius, leaving):
    """Return where a ray enters or leaves a sphere, and the unit vector from the centre to that point.

    Haines, Guenther and Akenine-Moeller, "Precision improvements for ray/sphere intersection", 2019: the squared
    distance of the line from the centre comes from their difference, not from a difference of squares, and of the two
    roots the smaller one from the product of both.

    Parameters
    ----------
    origin, direction, centre : (x, y, z), float64
        The direction may have any length above 0.
    radius : float64
    leaving : bool
        Which of the two crossings.

    Returns
    -------
    t, x, y, z : float64
        The crossing in lengths of the direction, which may be behind the origin, and the sphere's outer normal there.
        For a line that passes beside the sphere, by less than float32 resolves, the point of the line that is closest
        to the sphere, and the outer normal towards it.

    Notes
    -----
    The error of t is a few roundings of the distance from the origin to the centre, or of the radius if that is larger.
    A ray whose origin is on the surface in exact arithmetic of few bits, such as (1, 0, 0) of the unit sphere, has a t
    of exactly 0.
    """
    fx, fy, fz = origin[0] - centre[0], origin[1] - centre[1], origin[2] - centre[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    length_exponent = exponent_of(max(abs(fx), abs(fy), abs(fz), radius))
    direction_exponent = exponent_of(max(abs(dx), abs(dy), abs(dz)))
    fx, fy, fz = _scale(fx, fy, fz, -length_exponent)
    dx, dy, dz = _scale(dx, dy, dz, -direction_exponent)
    r = times_power_of_two(radius, -length_exponent)

    square = dx * dx + dy * dy + dz * dz
    # The point of the line that is closest to the centre, as seen from there.
    middle = -(fx * dx + fy * dy + fz * dz) / square
    ax, ay, az = fx + middle * dx, fy + middle * dy, fz + middle * dz
    across = math.sqrt(ax * ax + ay * ay + az * az)

    # Not r * r - across * across, which underflows for a small sphere far away.
    half_chord = math.sqrt(max((r - across) * (r + across), 0.0) / square)
    sign = 1.0 if leaving else -1.0
    t = middle + sign * half_chord
    if t * middle < 0.5 * middle * middle:
        # Much closer to zero than the middle: here the sum above cancels. The product of both roots does not.
        other = middle - sign * half_chord
        t = (fx * fx + fy * fy + fz * fz - r * r) / (square * other)

    nx, ny, nz = ax + sign * half_chord * dx, ay + sign * half_chord * dy, az + sign * half_chord * dz
    nx, ny, nz = _unit(nx, ny, nz)
    return times_power_of_two(t, length_exponent - direction_exponent), nx, ny, nz


@compiled
def _scale(x, y, z, exponent):
    return times_power_of_two(x, exponent), times_power_of_two(y, exponent), times_power_of_two(z, exponent)


@compiled(error_model="numpy")
def _unit(x, y, z):
    """Return the unit vector of a vector of any length, (1, 0, 0) for zero."""
    largest = max(abs(x), abs(y), abs(z))
    if not largest > 0.0:
        return 1.0, 0.0, 0.0
    x, y, z = _scale(x, y, z, -exponent_of(largest))
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length

"""Where a ray crosses a sphere, and the point of a sphere that is closest to a point, in float64.

Device code decides which spheres are hit, in float32. The functions here compute where, from the spheres as they are
given. All lengths are scaled by powers of two first, which rounds nothing, so spheres may have any size.
"""

from __future__ import annotations

import math

from ...support.compiled import compiled
from ...support.powers_of_two import exponent_of, times_power_of_two


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


@compiled(error_model="numpy")
def refine_sphere(origin, direction, centre, radius, leaving):
    """Return the t at which a ray enters or leaves a sphere; see `sphere_crossing`."""
    return sphere_crossing(origin, direction, centre, radius, leaving)[0]


@compiled(error_model="numpy")
def closest_on_sphere(point, centre, radius):
    """Return the direction in which a sphere's surface is closest to a point, and the point's height above it.

    Parameters
    ----------
    point, centre : (x, y, z), float64
    radius : float64

    Returns
    -------
    x, y, z : float64
        The unit vector from the centre to the closest point, which is at centre + radius * (x, y, z). From the centre
        itself, all points are equally close, and the vector is (1, 0, 0).
    height : float64
        The distance from the surface, negative inside.
    """
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    exponent = exponent_of(max(abs(x), abs(y), abs(z), radius))
    x, y, z = _scale(x, y, z, -exponent)
    r = times_power_of_two(radius, -exponent)
    squared = x * x + y * y + z * z
    # (d d - r r) / (d + r) is d - r with a smaller error beside the surface.
    height = (squared - r * r) / (math.sqrt(squared) + r)
    nx, ny, nz = _unit(x, y, z)
    return nx, ny, nz, times_power_of_two(height, exponent)


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

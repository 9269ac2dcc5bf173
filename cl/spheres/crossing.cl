// Where a ray crosses a sphere, and the coordinates u and v of a point on it, from which location and normal follow, in
// double.
//
// With the object's z axis as the axis of the sphere, u is the azimuth from the x axis towards the y axis in turns,
// from 0 to below 1, and v the angle from the z axis in half turns, from 0 to 1. A point comes back to within 1e-15 of
// the radius, wherever it is: next to the poles, where u is coarse, the circles around the axis are as small.
//
// Kernels decide which spheres are hit, in float. The functions here compute where, from the spheres as they are given.
// All lengths are scaled by powers of two first, which rounds nothing, so spheres may have any size.

#include "math/angles.cl"
#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define HALF_TURN 3.141592653589793

// (u, v) of a point on a sphere; the vector from the centre to the point has a length of about 1, which does not
// matter.
INLINED double2 sphere_uv(const double3 p)
{
    const double turns = angle_of(p.y, p.x) / (2.0 * HALF_TURN);
    const double u = turns < 0.0 ? turns + 1.0 : turns;
    // An angle just below zero is rounded up to a full turn.
    return (double2)(u >= 1.0 ? 0.0 : u, angle_of(sqrt(p.x * p.x + p.y * p.y), p.z) / HALF_TURN);
}

// The unit vector from the centre to the point (u, v), the sphere's outer normal.
//
// Sines and cosines are taken of an eighth of a turn at most, measured from the nearest axis, which rounds nothing: so
// the points on the axes are exact.
INLINED double3 sphere_point(const double u, const double v)
{
    const double quarter = floor(4.0 * u + 0.5);
    double2 azimuth = sine_and_cosine(2.0 * HALF_TURN * (u - 0.25 * quarter));
    if (quarter == 1.0) {
        azimuth = (double2)(azimuth.y, -azimuth.x);
    } else if (quarter == 2.0) {
        azimuth = -azimuth;
    } else if (quarter == 3.0) {
        azimuth = (double2)(-azimuth.y, azimuth.x);
    }
    const bool is_north = v < 0.25, is_south = v > 0.75;
    const double2 height = sine_and_cosine(HALF_TURN * (is_north ? v : is_south ? 1.0 - v : 0.5 - v));
    const double radius = is_north || is_south ? height.x : height.y;
    const double z = is_north ? height.y : is_south ? -height.y : height.x;
    return (double3)(azimuth.y * radius, azimuth.x * radius, z);
}

// The unit vector of a vector of any length, (1, 0, 0) for zero.
INLINED double3 unit_of_any(const double3 v)
{
    const double largest = largest_size(v);
    if (!(largest > 0.0)) {
        return (double3)(1.0, 0.0, 0.0);
    }
    const double3 scaled = times_power_of_two3(v, -exponent_of(largest));
    return scaled / sqrt(dot3(scaled, scaled));
}

// Returns where a ray enters or leaves a sphere: t, in lengths of the direction, which may be behind the origin. Writes
// the sphere's outer normal there. For a line that passes beside the sphere, by less than float resolves, it is the
// point of the line that is closest to the sphere, and the outer normal towards it.
//
// Haines, Guenther and Akenine-Moeller, "Precision improvements for ray/sphere intersection", 2019: the squared
// distance of the line from the centre comes from their difference, not from a difference of squares, and of the two
// roots the smaller one from the product of both.
//
// The error of t is a few roundings of the distance from the origin to the centre, or of the radius if that is larger.
// A ray whose origin is on the surface in exact arithmetic of few bits, such as (1, 0, 0) of the unit sphere, has a t
// of exactly 0.
INLINED double sphere_crossing(
    const double3 origin, const double3 direction, const double3 centre, const double radius, const bool is_leaving,
    double3 *normal)
{
    const double3 from_centre = origin - centre;
    const int length_exponent = exponent_of(most_of(largest_size(from_centre), radius));
    const int direction_exponent = exponent_of(largest_size(direction));
    const double3 f = times_power_of_two3(from_centre, -length_exponent);
    const double3 d = times_power_of_two3(direction, -direction_exponent);
    const double r = times_power_of_two(radius, -length_exponent);

    const double square = dot3(d, d);
    // The point of the line that is closest to the centre, as seen from there.
    const double middle = -dot3(f, d) / square;
    const double3 closest = f + middle * d;
    const double across = sqrt(dot3(closest, closest));

    // Not r * r - across * across, which underflows for a small sphere far away.
    const double half_chord = sqrt(most_of((r - across) * (r + across), 0.0) / square);
    const double to_crossing = is_leaving ? half_chord : -half_chord;
    double t = middle + to_crossing;
    if (t * middle < 0.5 * middle * middle) {
        // Much closer to zero than the middle: here the sum above cancels. The product of both roots does not.
        t = (dot3(f, f) - r * r) / (square * (middle - to_crossing));
    }
    *normal = unit_of_any(closest + to_crossing * d);
    // What lies beyond these is infinite or 0.
    return times_power_of_two(t, clamp(length_exponent - direction_exponent, -1991, 2046));
}

// Numbers and vectors of doubles, by the steps of the host's loops (clbvh/support/loop_functions.py), so that both find
// the same bits: sums and products are rounded one by one, and of two operands that do not compare the first stays.
//
// Assumes cl_khr_fp64, which has numbers below the normal ones and correctly rounded quotients.

// keep: no contraction
#include "math/numeric.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define FRACTION_BITS 52
#define EXPONENT_MASK 0x7ff
#define EXPONENT_BIAS 1023
#define LEAST_NORMAL -1022
#define MOST_NORMAL 1023

INLINED double least_of(const double a, const double b)
{
    return b < a ? b : a;
}

INLINED double most_of(const double a, const double b)
{
    return b > a ? b : a;
}

INLINED double largest_size(const double3 v)
{
    return most_of(most_of(fabs(v.x), fabs(v.y)), fabs(v.z));
}

INLINED double dot3(const double3 a, const double3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINED double3 cross3(const double3 a, const double3 b)
{
    return a.yzx * b.zxy - a.zxy * b.yzx;
}

INLINED int exponent_field(const double value)
{
    return (int)(as_long(value) >> FRACTION_BITS & EXPONENT_MASK) - EXPONENT_BIAS;
}

// e with 2^e <= |value| < 2^(e + 1); -1 for zero, and anything for infinity and NaN.
INLINED int exponent_of(const double value)
{
    const int exponent = exponent_field(value);
    return exponent >= LEAST_NORMAL ? exponent : value == 0.0 ? -1 : exponent_field(value * 0x1p64) - 64;
}

// 2^exponent; assumes that it is a normal number.
INLINED double power_of_two(const int exponent)
{
    return as_double((long)(exponent + EXPONENT_BIAS) << FRACTION_BITS);
}

// value * 2^exponent for exponents from -1991 to 2046, rounded once if it is no normal number.
INLINED double times_power_of_two(const double value, const int exponent)
{
    if (exponent > MOST_NORMAL) {
        return value * 0x1p1023 * power_of_two(exponent - MOST_NORMAL);
    }
    if (exponent < LEAST_NORMAL) {
        // By 2^-1022 at once, a number that is not normal would be rounded twice. What becomes none here becomes zero.
        return value * 0x1p-969 * power_of_two(exponent + 969);
    }
    return value * power_of_two(exponent);
}

INLINED double3 times_power_of_two3(const double3 v, const int exponent)
{
    return (double3)(
        times_power_of_two(v.x, exponent), times_power_of_two(v.y, exponent), times_power_of_two(v.z, exponent));
}

// The angle of the vector (x, y) with y >= 0 in radians, from 0 to pi; its error is at most 2 units in the last place.
// Both 0 give 0. By arctan(q) = arctan(c) + arctan((q - c) / (1 + q c)) for the nearest c of five, and the series of
// what is left, at most 1/8.
INLINED double arctangent_of(const double y, const double x)
{
    const double angles[5] = {
        0.0, 0.24497866312686415417, 0.46364760900080611621, 0.64350110879328438680, 0.78539816339744830962,
    };
    const double width = fabs(x);
    const double smaller_one = least_of(y, width);
    const double larger_one = most_of(y, width);
    const double quotient = larger_one > 0.0 ? smaller_one / larger_one : 0.0;
    const int nearest = (int)(4.0 * quotient + 0.5);
    const double c = 0.25 * nearest;
    const double r = (quotient - c) / (1.0 + quotient * c);
    const double t = r * r;
    double series = 0.0;
    for (int power = 17; power >= 3; power -= 2) {
        series = t * ((power & 2 ? -1.0 : 1.0) / power + series);
    }
    const double of_quotient = angles[nearest] + (r + r * series);
    const double from_x = y > width ? 1.57079632679489661923 - of_quotient : of_quotient;
    return x < 0.0 ? 3.14159265358979323846 - from_x : from_x;
}

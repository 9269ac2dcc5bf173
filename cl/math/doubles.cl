// Numbers and vectors of doubles, with the same bits on every device: sums and products are rounded one by one, and of
// two operands that do not compare the first stays.
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

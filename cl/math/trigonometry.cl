// Sines, cosines and their inverses by polynomials. Drivers may compute the built-in ones in any way that is precise
// enough; with these, all devices have the same bits.
//
// The coefficients minimize the largest relative error, by iteratively reweighted least squares (Lawson, 1961); the
// errors stated include the rounding, and are those that tests/kernel/test_numbers.py allows.

#include "math/numeric.cl"

#define PI 3.14159265f
#define HALF_PI 1.57079633f
#define QUARTER_PI 0.785398163f

// tan(pi / 8)
#define TANGENT_OF_EIGHTH 0.414213562f

// Returns the sine in x and the cosine in y of an angle from -1/8 to 1/8 turns.
INLINED float2 sin_cos_of_eighth(const float turns)
{
    const float t = turns * turns;
    return (float2)(
        turns * (6.28318529f + t * (-41.3416615f + t * (81.5923536f + t * -75.3935627f))),
        1.0f + t * (-19.7392086f + t * (64.9393107f + t * (-85.4422980f + t * 59.2027960f))));
}

// Returns the sine in x and the cosine in y of an angle in turns: 1 is 360 degrees. Absolute errors are at most 1e-7,
// and the relative one of the sine is as small near 0. Quarter turns are exact.
INLINED float2 sin_cos_turns(const float turns)
{
    // Both differences are exact.
    const float whole = turns - nearest_integer(turns);
    const float quarters = nearest_integer(4.0f * whole);
    const float r = whole - 0.25f * quarters;

    const float2 part = sin_cos_of_eighth(r);
    const float sine = part.x;
    const float cosine = part.y;

    const int quadrant = (int)quarters;
    const float of_sine = quadrant & 1 ? cosine : sine;
    const float of_cosine = quadrant & 1 ? -sine : cosine;
    return (float2)(quadrant & 2 ? -of_sine : of_sine, quadrant & 2 ? -of_cosine : of_cosine);
}

// The arctangent from 0 to 1 of the quotient of two numbers, 0 <= smaller_one <= larger_one, in radians.
INLINED float arctangent_of_quotient(const float smaller_one, const float larger_one)
{
    // By arctan(q) = pi / 4 + arctan((q - 1) / (q + 1)), the polynomial is used from -tan(pi / 8) to tan(pi / 8).
    const bool is_large = smaller_one > TANGENT_OF_EIGHTH * larger_one;
    const float above = is_large ? smaller_one - larger_one : smaller_one;
    const float below = is_large ? smaller_one + larger_one : larger_one;
    const float q = below > 0.0f ? above / below : 0.0f;
    const float t = q * q;
    const float series =
        t * (-0.333333080f + t * (0.199982170f + t * (-0.142400830f + t * (0.105734800f + t * -0.0603479000f))));
    return (is_large ? QUARTER_PI : 0.0f) + (q + q * series);
}

// Returns the angle of the vector (x, y) in radians, from -pi to pi. The relative error is at most 2e-7. Zeros give
// the angles of atan2 but for their signs: (0, 0) gives 0. Assumes |x| + |y| finite.
INLINED float arctangent2(const float y, const float x)
{
    const float width = absolute(x);
    const float height = absolute(y);
    const bool is_steep = height > width;
    const float angle = arctangent_of_quotient(is_steep ? width : height, is_steep ? height : width);
    const float from_x = is_steep ? HALF_PI - angle : angle;
    const float upper = x < 0.0f ? PI - from_x : from_x;
    return y < 0.0f ? -upper : upper;
}

// Returns the angle in radians, from 0 to pi, of which x is the cosine. x is limited to -1..1. The relative error is at
// most 2.5e-7, near 1 also.
INLINED float arccosine(const float x)
{
    const float limited = clamp(x, -1.0f, 1.0f);
    return 2.0f * arctangent2(square_root(1.0f - limited), square_root(1.0f + limited));
}

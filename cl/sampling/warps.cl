// Maps of the unit square, [0, 1) in x and y, onto other sets. They keep areas in proportion, or weight them as said,
// and neighbours stay neighbours.
//
// Written for single numbers: PoCL draws eight samples at once then, and none if there is a vector among them.

#include "math/trigonometry.cl"

// The disk of radius 1, evenly: squares around the centre become circles (Shirley and Chiu, "A low distortion map
// between disk and square", 1997). *rest is 1 - x^2 - y^2, without the rounding of that.
INLINED float2 map_to_disk(const float2 sample, float *rest)
{
    const float x = 2.0f * sample.x - 1.0f;
    const float y = 2.0f * sample.y - 1.0f;
    const bool is_wide = absolute(x) > absolute(y);
    const float radius = is_wide ? x : y;
    const float other = is_wide ? y : x;
    *rest = (1.0f - radius) * (1.0f + radius);
    // From -1/8 to 1/8 turns around the nearer axis.
    const float2 turned = sin_cos_of_eighth(radius == 0.0f ? 0.0f : 0.125f * (other / radius));
    return (float2)(radius * (is_wide ? turned.y : turned.x), radius * (is_wide ? turned.x : turned.y));
}

INLINED float2 sample_disk(const float2 sample)
{
    float rest;
    return map_to_disk(sample, &rest);
}

// The hemisphere around z; the density of directions is their z / pi (Malley's method).
INLINED float3 sample_hemisphere(const float2 sample)
{
    float rest;
    const float2 disk = map_to_disk(sample, &rest);
    return (float3)(disk.x, disk.y, square_root(rest));
}

// The cone around z, evenly. Its width is 1 - cos(half the apex angle), from 0 to 2: a cosine of a narrow cone, such as
// that of the sun, has few bits left.
INLINED float3 sample_cone(const float2 sample, const float one_minus_cosine)
{
    const float depth = sample.x * one_minus_cosine;
    const float radius = square_root(depth * (2.0f - depth));
    const float2 turned = sin_cos_turns(sample.y);
    return (float3)(radius * turned.y, radius * turned.x, 1.0f - depth);
}

// All directions, evenly.
INLINED float3 sample_sphere(const float2 sample)
{
    return sample_cone(sample, 2.0f);
}

// Numbers from -1 to 1 whose density falls from 1 at 0 to 0 at both ends, the tent filter.
INLINED float sample_tent(const float sample)
{
    return sample < 0.5f ? square_root(2.0f * sample) - 1.0f : 1.0f - square_root(2.0f - 2.0f * sample);
}

INLINED float2 sample_tent_2d(const float2 sample)
{
    return (float2)(sample_tent(sample.x), sample_tent(sample.y));
}

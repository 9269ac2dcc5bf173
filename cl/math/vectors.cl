// Functions of vectors, written out. Drivers may compute the built-in ones of the same purpose in any way that is
// precise enough: Intel's fuses products and sums in `cross` and `mix`, llvmpipe in `mix`. With these, all give a
// picture the same bytes.

#include "math/numeric.cl"

INLINED float dot_product(const float3 a, const float3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINED float3 cross_product(const float3 a, const float3 b)
{
    return a.yzx * b.zxy - a.zxy * b.yzx;
}

// a at 0, b at 1, and linear between them.
INLINED float3 blend(const float3 a, const float3 b, const float fraction)
{
    return a + (b - a) * fraction;
}

// The power of two that brings the largest component to between 1 and 4: then no square leaves float32.
INLINED float unit_scale(const float3 v)
{
    const float3 size = magnitude(v);
    const int exponent = as_int(larger(size.x, larger(size.y, size.z))) & 0x7f800000;
    const int inverse = 0x7f000000 - exponent;
    return as_float(inverse > 0x00800000 ? inverse : 0x00800000);
}

// The vector of length 1 in the same direction, from any length; zero stays zero.
INLINED float3 unit_vector(const float3 v)
{
    const float3 scaled = unit_scale(v) * v;
    const float length_squared = dot_product(scaled, scaled);
    return length_squared > 0.0f ? scaled / square_root(length_squared) : v;
}

// The normal of a triangle by two of its edges, of any length; zero if they are parallel. Edges are scaled first: the
// product of two edges of a tiny or huge triangle would leave float32.
INLINED float3 normal_of_edges(const float3 ab, const float3 ac)
{
    const float3 normal = cross_product(ab, ac);
    const float length_squared = dot_product(normal, normal);
    // The scales are powers of two: where nothing leaves float32, the bits are the same without them.
    if (length_squared > 1e-24f && length_squared < 1e24f) {
        return normal / square_root(length_squared);
    }
    return unit_vector(cross_product(unit_scale(ab) * ab, unit_scale(ac) * ac));
}

// The same as unit_vector for a vector of moderate length, 1e-15 to 1e15, which needs no scaling.
INLINED float3 short_unit_vector(const float3 v)
{
    return v * (1.0f / square_root(dot_product(v, v)));
}

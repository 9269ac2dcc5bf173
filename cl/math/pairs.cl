// Sums and products of vectors as pairs of floats: what the rounding of the first has left off is in the second.

#include "math/numeric.cl"

// a + b, and in *low what its rounding has left off (Knuth, "The art of computer programming", volume 2, 1969).
INLINED float3 add_exactly(const float3 a, const float3 b, float3 *low)
{
    const float3 sum = a + b;
    const float3 of_b = sum - a;
    *low = (a - (sum - of_b)) + (b - of_b);
    return sum;
}

// factor * v, and in *low what its rounding has left off.
INLINED float3 multiply_exactly(const float factor, const float3 v, float3 *low)
{
    const float3 product = factor * v;
    *low = (float3)(
        FUSED(factor, v.x, -product.x), FUSED(factor, v.y, -product.y), FUSED(factor, v.z, -product.z));
    return product;
}

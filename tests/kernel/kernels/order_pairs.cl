// smaller and larger.
//
// pairs[count]                      two floats
// lesser[count], greater[count]     written; of the pair

#include "math/numeric.cl"

kernel void order_pairs(
    const global float2 *restrict pairs, global float *restrict lesser, global float *restrict greater,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float2 p = pairs[i];
    lesser[i] = smaller(p.x, p.y);
    greater[i] = larger(p.x, p.y);
}

// smaller, larger and their float3 forms.
//
// pairs[count]                                  two floats
// lesser[count], greater[count]                 written; of the pair
// lesser3[count], greater3[count]               written; of (x, y, -x) and (y, x, -y)

#include "numeric.cl"

kernel void order_pairs(
    const global float2 *restrict pairs, global float *restrict lesser, global float *restrict greater,
    global float *restrict lesser3, global float *restrict greater3, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float2 p = pairs[i];
    lesser[i] = smaller(p.x, p.y);
    greater[i] = larger(p.x, p.y);
    vstore3(smaller3((float3)(p.x, p.y, -p.x), (float3)(p.y, p.x, -p.y)), i, lesser3);
    vstore3(larger3((float3)(p.x, p.y, -p.x), (float3)(p.y, p.x, -p.y)), i, greater3);
}

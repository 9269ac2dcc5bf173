// exact_difference: a * b - c * d.
//
// factors[count]                    a, b, c, d
// differences[count]                written

#include "triangle.cl"

kernel void subtract_products(
    const global float4 *restrict factors, global float *restrict differences, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float4 f = factors[i];
    differences[i] = exact_difference(f.x, f.y, f.z, f.w);
}

// difference_of_products: a * b - c * d.
//
// factors[count]                    a, b, c, d
// differences[count]                written

#include "triangles/triangle.cl"

kernel void subtract_products(
    const global float4 *restrict factors, global float *restrict differences, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float4 f = factors[i];
    differences[i] = difference_of_products(f.x, f.y, f.z, f.w);
}

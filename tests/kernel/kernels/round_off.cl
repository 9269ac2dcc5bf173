// Expressions that a compiler may contract, unless numeric.cl forbids it.
//
// factors[count]                      a, b, c, d
// sums[count], differences[count]     written; a * b + c and a * b - c * d

// keep: forbids contraction
#include "math/numeric.cl"

kernel void round_off(
    const global float4 *restrict factors, global float *restrict sums, global float *restrict differences,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float4 f = factors[i];
    sums[i] = f.x * f.y + f.z;
    differences[i] = f.x * f.y - f.z * f.w;
}

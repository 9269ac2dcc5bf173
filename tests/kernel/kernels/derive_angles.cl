// The functions of math/trigonometry.cl, by row.
//
// vectors[count]                        float2
// sines[2 * count]                      written: sin_cos_turns of x
// angles[count], arccosines[count]      written: arctangent2(y, x); arccosine of x

#include "math/trigonometry.cl"

kernel void derive_angles(
    const global float2 *restrict vectors, global float2 *restrict sines, global float *restrict angles,
    global float *restrict arccosines, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    sines[i] = sin_cos_turns(vectors[i].x);
    angles[i] = arctangent2(vectors[i].y, vectors[i].x);
    arccosines[i] = arccosine(vectors[i].x);
}

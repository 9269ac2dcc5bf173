// Normals from their 32 bits, by row.
//
// packed[count]          uint
// normals[3 * count]     written

#include "looks/looks.cl"

kernel void decode_normals(const global uint *restrict packed, global float *restrict normals, const int count)
{
    const int i = get_global_id(0);
    if (i < count) {
        vstore3(decode_normal(packed[i]), i, normals);
    }
}

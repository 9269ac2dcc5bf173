// The functions of sampling/frame.cl, by row.
//
// normals[3 * count], vectors[3 * count]        float: unit vectors; any vectors
// frames[9 * count]                             written: tangent, bitangent, normal
// outside[3 * count], inside[3 * count]         written: from_frame and to_frame of the vector

#include "sampling/frame.cl"

kernel void frame_normals(
    const global float *restrict normals, const global float *restrict vectors, global float *restrict frames,
    global float *restrict outside, global float *restrict inside, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const frame_t frame = frame_around(vload3(i, normals));
    vstore3(frame.tangent, 3 * i, frames);
    vstore3(frame.bitangent, 3 * i + 1, frames);
    vstore3(frame.normal, 3 * i + 2, frames);
    const float3 vector = vload3(i, vectors);
    vstore3(from_frame(&frame, vector), i, outside);
    vstore3(to_frame(&frame, vector), i, inside);
}

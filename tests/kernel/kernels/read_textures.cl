// Colours of textures, by row.
//
// uvs[count]              float2
// texture_ids[count]      int
// textures[], texels[], decoded_srgb[]      see looks/looks.cl
// colours[count]          written: float4

#include "looks/texture.cl"

kernel void read_textures(
    const global float2 *restrict uvs, const global int *restrict texture_ids,
    const global texture_t *restrict textures, const global uint *restrict texels,
    const global float *restrict decoded_srgb, global float4 *restrict colours, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const texture_tables_t tables = {textures, texels, decoded_srgb};
    colours[i] = sample_texture(&tables, texture_ids[i], uvs[i]);
}

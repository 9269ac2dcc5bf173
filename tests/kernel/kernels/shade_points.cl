// The functions of shading/shade.cl, by row.
//
// vectors[3 * count]                      float: linear colour, unit normal, or position
// views[1]                                view_t
// encoded[3 * count]                      written: encode_srgb of the vector
// lit[3 * count], unlit[3 * count]        written: shade_lambert with the vector as normal
// depths[3 * count]                       written: shade_depth with the vector as position
// backgrounds[3 * count]                  written: shade_background in row i

#include "shading/shade.cl"

kernel void shade_points(
    const global float *restrict vectors, const global view_t *restrict views, global float *restrict encoded,
    global float *restrict lit, global float *restrict unlit, global float *restrict depths,
    global float *restrict backgrounds, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float3 vector = vload3(i, vectors);
    vstore3(encode_srgb(vector), i, encoded);
    vstore3(shade_lambert(views, load3(views->surface_colour), vector, true), i, lit);
    vstore3(shade_lambert(views, load3(views->surface_colour), vector, false), i, unlit);
    vstore3(shade_depth(views, vector), i, depths);
    vstore3(shade_background(views, i), i, backgrounds);
}

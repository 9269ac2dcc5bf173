// The colours of a film: exposure, tone curve, and sRGB.
//
// film[row_count * width]      float4: sums of linear red, green, blue, and of the share that is covered
// row_count                    rows of the film
// sample_count                 samples in the sums
// counts[row_count * width]    samples in the sum of each pixel; NULL where that is sample_count
// view[1]                      view_t
// colours[row_count * width]   written: red, green, blue and alpha; alpha is 255 where all samples hit something
//
// Work-items: (width, row_count), rounded up to tiles.

#include "film/tone.cl"
#include "shading/shade.cl"

kernel void develop(
    const global float4 *restrict film, const int row_count, const int sample_count,
    const global int *restrict counts, const global view_t *restrict view, global uchar4 *restrict colours)
{
    const int column = get_global_id(0);
    const int row = get_global_id(1);
    if (column >= view->width || row >= row_count) {
        return;
    }
    const int pixel = row * view->width + column;
    const float4 mean = film[pixel] / (float)(counts ? counts[pixel] : sample_count);
    // Light that is seen before a transparent background is that of the covered share alone.
    const float share = view->is_transparent && mean.w > 0.0f ? mean.w : 1.0f;
    const float3 light = view->exposure / share * mean.xyz;
    const float3 colour = encode_srgb(view->tone_curve == TONE_FILMIC ? map_filmic(light) : light);
    colours[pixel] = (uchar4)(convert_uchar3_sat_rte(255.0f * colour), convert_uchar_sat_rte(255.0f * mean.w));
}

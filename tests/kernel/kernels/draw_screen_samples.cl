// Samples of pixels, by row.
//
// begins[count]          uint4: column, row, sample index, seed
// samples[count]         written: float2
// patterns[count]        written: float2, where in the pixel the sample is before the filter

#include "film/pixel.cl"
#include "sampling/screen.cl"

kernel void draw_screen_samples(
    const global uint4 *restrict begins, global float2 *restrict samples, global float2 *restrict patterns,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const uint4 begin = begins[i];
    sobol_sampler_t sampler = make_screen_sampler(begin.x, begin.y, begin.z, begin.w);
    samples[i] = sample_2d(&sampler);
    patterns[i] = pattern_point(begin.z);
}

// Samples as bits and as numbers, by row.
//
// begins[count]                       uint4: number, sample index, seed; w is hashed
// samples[count][6]                   written: sample_2d, sample_1d, sample_2d, sample_1d
// bits[count]                         written: hash_number, reverse_bits, sobol_second_reversed and
//                                     scramble (by `seed`) of w

#include "sampling/sampler.cl"

kernel void draw_samples(
    const global uint4 *restrict begins, global float *restrict samples, global uint4 *restrict bits, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const uint4 begin = begins[i];
    sobol_sampler_t sampler = make_sampler(begin.x, begin.y, begin.z);
    vstore2(sample_2d(&sampler), 0, samples + 6 * i);
    samples[6 * i + 2] = sample_1d(&sampler);
    const float2 pair = sample_2d(&sampler);
    samples[6 * i + 3] = pair.x;
    samples[6 * i + 4] = pair.y;
    samples[6 * i + 5] = sample_1d(&sampler);
    bits[i] = (uint4)(
        hash_number(begin.w), reverse_bits(begin.w), sobol_second_reversed(begin.w), scramble(begin.w, begin.z));
}

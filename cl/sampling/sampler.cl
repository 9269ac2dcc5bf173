// Sample points in any number of dimensions: Owen-scrambled Sobol points in pairs of dimensions, each pair with its own
// scrambling and its own order of the points (Burley, "Practical hash-based Owen scrambling", Journal of Computer
// Graphics Techniques 9(4), 2020).
//
// The samples 0, 1, 2, ... of one number, such as a pixel, are spread evenly in each pair of dimensions, and best after
// a power of two of them. Numbers, pairs and seeds are independent of each other.

#include "sampling/owen.cl"
#include "sampling/sobol.cl"

typedef struct {
    uint index;      // of the sample
    uint seed;       // hash of the number and the user's seed
    uint dimension;  // calls so far
} sobol_sampler_t;  // OpenCL has a type sampler_t, for images

// Begins sample `sample_index` of a number: a pixel, a point, or another thing that is sampled by itself.
INLINED sobol_sampler_t make_sampler(const uint number, const uint sample_index, const uint seed)
{
    const sobol_sampler_t sampler = {sample_index, hash_with_seed(number, seed), 0u};
    return sampler;
}

// A fixed-point number as a float from 0 to just below 1; rounding to nearest would reach 1.
INLINED float as_unit_float(const uint x)
{
    return (float)(x >> 8) * 0x1p-24f;
}

// The seed of the next one or two dimensions.
INLINED uint next_seed(sobol_sampler_t *sampler)
{
    return hash_with_seed(sampler->dimension++, sampler->seed);
}

// The first or the second number of the pair of dimensions with a seed, as a fixed-point number: 2^32 would be 1.
INLINED uint draw_number(const sobol_sampler_t *sampler, const uint seed, const bool is_second)
{
    const uint index = scramble(sampler->index, seed);
    const uint point = is_second ? sobol_second_reversed(index) : index;
    return reverse_bits(scramble_reversed(point, hash_number(seed ^ (is_second ? 2u : 1u))));
}

// The next dimension, in [0, 1).
INLINED float sample_1d(sobol_sampler_t *sampler)
{
    return as_unit_float(draw_number(sampler, next_seed(sampler), false));
}

// The next two dimensions, in [0, 1) each.
INLINED float2 sample_2d(sobol_sampler_t *sampler)
{
    const uint seed = next_seed(sampler);
    return (float2)(
        as_unit_float(draw_number(sampler, seed, false)), as_unit_float(draw_number(sampler, seed, true)));
}

// Pairs of dimensions that sample_pairs draws at once.
#define PAIR_COUNT 4

// The next pairs of dimensions, as fixed-point numbers.
INLINED void sample_pairs(sobol_sampler_t *sampler, uint numbers[2 * PAIR_COUNT])
{
    // Compilers for CPUs compute all rounds of the loop at once, in vectors.
    for (uint number = 0; number < 2 * PAIR_COUNT; number++) {
        const uint seed = hash_with_seed(sampler->dimension + number / 2, sampler->seed);
        numbers[number] = draw_number(sampler, seed, number & 1u);
    }
    sampler->dimension += PAIR_COUNT;
}

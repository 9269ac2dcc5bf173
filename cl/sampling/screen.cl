// Sample points for pictures of few samples: neighbouring pixels share out one sequence of points, so that the noise of
// a picture is fine-grained and even, which the eye overlooks sooner than the clumps of independent noise (Ahmed and
// Wonka, "Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical ordering of pixels", 2020).

#include "sampling/sampler.cl"

// A power of two of samples is taken of each pixel from one sequence; further ones are from other sequences.
#define SEQUENCE_SAMPLE_BITS 3
#define SEQUENCE_SAMPLE_MASK ((1u << SEQUENCE_SAMPLE_BITS) - 1)

// Bits of a column and of a row that tell pixels apart: points repeat after 16,384 pixels.
#define SEQUENCE_PIXEL_MASK 0x3fffu

// Moves bit i of a 16-bit number to bit 2 i.
INLINED uint spread_bits(uint x)
{
    x = (x | x << 8) & 0x00ff00ffu;
    x = (x | x << 4) & 0x0f0f0f0fu;
    x = (x | x << 2) & 0x33333333u;
    return (x | x << 1) & 0x55555555u;
}

// Begins sample `sample_index` of a pixel. The pixels of each aligned square of 2^k have consecutive points of the
// sequence, which are evenly spread together.
INLINED sobol_sampler_t make_screen_sampler(const int column, const int row, const uint sample_index, const uint seed)
{
    const uint curve =
        spread_bits((uint)column & SEQUENCE_PIXEL_MASK) | spread_bits((uint)row & SEQUENCE_PIXEL_MASK) << 1;
    const uint sequence = sample_index >> SEQUENCE_SAMPLE_BITS;
    const sobol_sampler_t sampler = {
        curve << SEQUENCE_SAMPLE_BITS | (sample_index & SEQUENCE_SAMPLE_MASK), hash_with_seed(sequence, seed), 0u};
    return sampler;
}

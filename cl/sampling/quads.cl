// Four dimensions of a sample, spread evenly together: for what depends on all of them, a place and a direction.

#include "sampling/sampler.cl"

// The next four dimensions of Sobol's sequence, as fixed-point numbers: 2^32 would be 1.
INLINED void sample_quad(sobol_sampler_t *sampler, uint numbers[4])
{
    // What each bit of an index adds to the third and the fourth dimension, with its bits reversed: by the polynomials
    // x^2 + x + 1 and x^3 + x + 1 (Joe and Kuo, "Constructing Sobol sequences with better two-dimensional projections",
    // 2008).
    const uint columns[2][32] = {
        {0x1u, 0x3u, 0x6u, 0x9u, 0x17u, 0x3au, 0x71u, 0xa3u, 0x116u, 0x339u, 0x677u, 0x9aau, 0x1601u, 0x3903u, 0x7706u,
         0xaa09u, 0x10117u, 0x3033au, 0x60671u, 0x909a3u, 0x171616u, 0x3a3939u, 0x717777u, 0xa3aaaau, 0x1170001u,
         0x33a0003u, 0x6710006u, 0x9a30009u, 0x16160017u, 0x3939003au, 0x77770071u, 0xaaaa00a3u},
        {0x1u, 0x3u, 0x4u, 0xau, 0x1fu, 0x2eu, 0x45u, 0xc9u, 0x11bu, 0x2a4u, 0x79au, 0xb67u, 0x101eu, 0x302du, 0x4041u,
         0xa0c3u, 0x1f104u, 0x2e28au, 0x457dfu, 0xc9baeu, 0x11a105u, 0x2a7289u, 0x79e7dbu, 0xb6dba4u, 0x100011au,
         0x30002a7u, 0x400079eu, 0xa000b6du, 0x1f001001u, 0x2e003003u, 0x45004004u, 0xc900a00au}};
    const uint seed = next_seed(sampler), index = scramble(sampler->index, seed);
    uint points[4] = {index, sobol_second_reversed(index), 0u, 0u};
    for (uint bit = 0; bit < 32; bit++) {
        const uint chosen = -((index >> bit) & 1u);
        points[2] ^= columns[0][bit] & chosen;
        points[3] ^= columns[1][bit] & chosen;
    }
    for (uint number = 0; number < 4; number++) {
        numbers[number] = reverse_bits(scramble_reversed(points[number], hash_number(seed ^ (number + 1u))));
    }
}

// Hashes of 32-bit numbers, from which everything random begins.

#include "math/inlined.cl"

// A bijection in which every bit of the input changes every bit of the result with a probability close to 1/2: two
// rounds of the form and by the search of Wellons ("Prospecting for hash functions", 2018).
INLINED uint hash_number(uint x)
{
    x ^= x >> 16;
    x *= 0x21f0aaadu;
    x ^= x >> 15;
    x *= 0xd35a2d97u;
    x ^= x >> 15;
    return x;
}

// The hash of a number under a seed. The golden ratio keeps (0, 0) from being a fixed point.
INLINED uint hash_with_seed(const uint x, const uint seed)
{
    return hash_number(x ^ hash_number(seed + 0x9e3779b9u));
}

INLINED uint reverse_bits(uint x)
{
    x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
    return (x >> 16) | (x << 16);
}

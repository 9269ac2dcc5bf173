// Owen scrambling: the halves of an interval are swapped or not, and so are the halves of each half, and so on, each by
// a random bit of its own. What is evenly spread stays so (Owen, "Randomly permuted (t,m,s)-nets and (t,s)-sequences",
// 1995).

#include "sampling/hash.cl"

// Scrambles a number whose bits are reversed: a bit of the result depends on the bits below it and on itself. The hash
// is that of Laine and Karras ("Stratified sampling for stochastic transparency", 2011), with the multipliers that
// Vegdahl found ("Building a better LK hash", 2021). Assumes a seed that is a hash.
INLINED uint scramble_reversed(uint x, const uint seed)
{
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

// Scrambles a number: a bit of the result depends on the bits above it and on itself.
INLINED uint scramble(const uint x, const uint seed)
{
    return reverse_bits(scramble_reversed(reverse_bits(x), seed));
}

// The first two dimensions of Sobol's sequence ("On the distribution of points in a cube", 1967). Of every aligned
// block of 2^k points, each elementary interval of area 2^-k has one point.
//
// Dimensions are fixed-point numbers, 1 is 2^32, and here their bits are reversed, as Owen scrambling takes them: the
// first dimension is then the index itself.

#include "math/inlined.cl"

// The second dimension of a point, with its bits reversed. Its matrix is Pascal's triangle modulo 2, in which an entry
// is 1 where the bits of one index are a subset of the other's; so it is a product of five sparse matrices.
INLINED uint sobol_second_reversed(uint index)
{
    index ^= (index & 0xaaaaaaaau) >> 1;
    index ^= (index & 0xccccccccu) >> 2;
    index ^= (index & 0xf0f0f0f0u) >> 4;
    index ^= (index & 0xff00ff00u) >> 8;
    index ^= index >> 16;
    return index;
}

// Bits of numbers that interleave.

// keep: no contraction
#include "math/numeric.cl"

// The ten lowest bits of a number at every third position.
INLINED uint spread_bits(const uint number)
{
    uint bits = number & 0x3ff;
    bits = (bits | bits << 16) & 0x030000ff;
    bits = (bits | bits << 8) & 0x0300f00f;
    bits = (bits | bits << 4) & 0x030c30c3;
    return (bits | bits << 2) & 0x09249249;
}

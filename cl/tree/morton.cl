// Morton codes of centroids: the bits of three coordinates in turn (Morton, 1966).
//
// The grid is a cube around all local coordinates, which are from -1 to 1, so that its cells follow from a
// multiplication by a power of two: a division would be rounded differently by some devices.

#include "math/bits.cl"
#include "tree/boxes.cl"

// Bits of a coordinate in one key, and in all keys.
#define AXIS_BITS 10
#define ALL_AXIS_BITS 20

INLINED uint cell_of(const float doubled_centroid)
{
    const float position = (doubled_centroid + 2.0f) * (float)(1 << (ALL_AXIS_BITS - 2));
    return (uint)smaller(larger(position, 0.0f), (float)((1 << ALL_AXIS_BITS) - 1));
}

// The key of a box: its upper bits, or for `is_fine` the lower ones.
INLINED uint morton_key(const box_t box, const int is_fine)
{
    const float3 centroid = box.lower + box.upper;
    const int shift = is_fine ? 0 : ALL_AXIS_BITS - AXIS_BITS;
    return spread_bits(cell_of(centroid.x) >> shift) << 2 | spread_bits(cell_of(centroid.y) >> shift) << 1
        | spread_bits(cell_of(centroid.z) >> shift);
}

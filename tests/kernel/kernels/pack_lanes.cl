// mask_bits and lowest_bit.
//
// values[count][WIDTH]           lanes that are below zero or not
// bits[count], lowest[count]     written; a bit for each lane below zero, and the lowest of them, -1 without any

#include "traversal/traverse.cl"
#include "math/lanes.cl"

kernel void pack_lanes(
    const global float *restrict values, global uint *restrict bits, global int *restrict lowest, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    bits[i] = mask_bits(load_lanes(values + WIDTH * i) < 0.0f);
    lowest[i] = bits[i] == 0 ? -1 : lowest_bit(bits[i]);
}

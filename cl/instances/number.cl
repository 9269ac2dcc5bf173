// The numbers that primitives have on the device. Those of merged instances are in one tree, in the order of
// (instance_id, prim_id), and a number says both; see structs.INSTANCE.

#include "structs.cl"

INLINED scene_prim_t split_number(const int number, const int first_instance_id, const int prim_bits)
{
    const scene_prim_t prim = {number & (int)((1u << prim_bits) - 1u), first_instance_id + (number >> prim_bits)};
    return prim;
}

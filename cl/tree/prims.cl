// The primitives that a tree is built over.

#include "tree/boxes.cl"

// points, corners   see tree/boxes.cl
// pairs[n]          keys and, in the lower half, primitives, in the order of the keys
typedef struct {
    const global float *points;
    const global int *corners;
    const global ulong *pairs;
} prims_t;

INLINED int prim_at(const prims_t *prims, const int place)
{
    return (int)(uint)prims->pairs[place];
}

// The primitive nearest to a point in the `brute` layout: all are tested.

#include "nearest/search.cl"
#include "prims/single.cl"
#include "traversal/brute.cl"

INLINED void find_nearest(
    const global node_t *nodes, const global block_t *blocks, const int block_count, nearest_t *nearest)
{
    for (int prim_index = 0; prim_index < block_count; prim_index++) {
        test_single(nearest, blocks, prim_index);
    }
}

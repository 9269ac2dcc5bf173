// The triangle nearest to a point in the `brute` layout: all are tested.

#include "nearest/single.cl"
#include "traversal/brute.cl"

INLINED void find_nearest(
    const global node_t *nodes, const global block_t *blocks, const int block_count, nearest_t *nearest)
{
    for (int triangle_index = 0; triangle_index < block_count; triangle_index++) {
        test_triangle(nearest, blocks, triangle_index);
    }
}

// The `brute` layout: no tree, every primitive is tested against every ray. The baseline of the study, for small
// meshes.

#include "prims/single.cl"

// The type of `nodes`, which are not read.
typedef bvh2_node_t node_t;

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const int block_count,
    const ray_t *ray, search_t *search, const int query)
{
    for (int prim_index = 0; prim_index < block_count && !is_complete(search, query); prim_index++) {
        intersect_single(blocks, prim_index, ray, search, query);
    }
}

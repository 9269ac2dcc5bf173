// traverse with QUERY_COUNT up to 1: the crossing at which a search for any hit ends.
//
// rays[count], nodes[node_count], blocks[block_count]     the tree in a layout that does not need block_count
// hits[count]                                             written
// reported[count]                                         written: prim_id is the number of reported crossings

#include "hits/search.cl"

// Counts in the heap, which no count of crossings uses.
#define add_crossing(search, crossing, query) ((search)->heap->prim_id++, add_crossing(search, crossing, query))

#include "traversal/traverse.cl"

kernel void find_any(
    const global packed_ray_t *restrict rays, const global node_t *restrict nodes,
    const global block_t *restrict blocks, global hit_t *restrict hits, global hit_t *restrict reported,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    search_t search = make_search(1, reported + i);
    reported[i].prim_id = 0;
    traverse(nodes, nodes, blocks, 0, &ray, &search, QUERY_COUNT);
    hits[i] = as_hit(&search.nearest);
}

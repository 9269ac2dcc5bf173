// The first few hits of each ray, in the order along it: enough for most rays, in one traversal.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// order[ray_count]                               where results go: the number of each ray; without it its place
// hits[places * ray_count]                       written; those of ray i begin at i * places, and if they are fewer than
//                                                places, a miss follows
//
// A ray whose places are all taken may have further hits: count_hits and all_hits find them.

#include "traverse.cl"

kernel void first_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count,
    const global int *restrict order, const int places)
{
    const int item = get_global_id(0);
    if (item >= ray_count) {
        return;
    }
    const int ray = number_of_ray(order, item);
    global hit_t *kept = hits + (size_t)ray * places;
    const path_t path = load_path(rays + item);
    search_t search = begin_search(places, kept);
    traverse(nodes, groups, group_count, &path, &search, QUERY_KEEP);
    sort_hits(&search);
    if (search.count < places) {
        kept[search.count].prim_id = NO_PRIM;
    }
}

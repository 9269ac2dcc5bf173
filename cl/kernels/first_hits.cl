// The first few hits of each ray, in the order along it: enough for most rays, in one traversal.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// width                                          rays in a row, see cl/batch.cl
// order[ray_count]                               where results go: the number of each ray; without it its place
// entries[tile_count]                            where each tile enters the tree, see cl/entry.cl; without, at the root
// hits[places * ray_count]                       written; those of ray i begin at i * places, and if they are fewer than
//                                                places, a miss follows
//
// A ray whose places are all taken may have further hits: count_hits and all_hits find them.

#include "entry.cl"

kernel void first_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count,
    const int width, const global int *restrict order, const global node_t *restrict entries, const int places)
{
    const int place = place_of_ray(width, ray_count);
    if (place == NO_RAY) {
        return;
    }
    const int ray = number_of_ray(order, place);
    global hit_t *kept = hits + (size_t)ray * places;
    const path_t path = load_path(rays + place);
    search_t search = begin_search(places, kept);
    traverse(nodes, find_start(nodes, entries), groups, group_count, &path, &search, QUERY_KEEP);
    sort_hits(&search);
    if (search.count < places) {
        kept[search.count].prim_id = NO_PRIM;
    }
}

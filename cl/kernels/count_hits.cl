// How often each ray crosses the mesh between its t_min and its t_max.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// width                                          rays in a row, see cl/batch.cl
// order[ray_count]                               where results go: the number of each ray; without it its place
// entries[tile_count]                            where each tile enters the tree, see cl/entry.cl; without, at the root
// counts[ray_count]                              written; at most max_hits, which is at least 1

#include "entry.cl"

kernel void count_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global int *restrict counts, const int ray_count,
    const int width, const global int *restrict order, const global node_t *restrict entries, const int max_hits)
{
    const int place = place_of_ray(width, ray_count);
    if (place == NO_RAY) {
        return;
    }
    const int ray = number_of_ray(order, place);
    const path_t path = load_path(rays + place);
    search_t search = begin_search(max_hits, 0);
    traverse(nodes, find_start(nodes, entries), groups, group_count, &path, &search, QUERY_COUNT);
    counts[ray] = search.count;
}

// How often each ray crosses the mesh between its t_min and its t_max.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// order[ray_count]                               where results go: the number of each ray; without it its place
// counts[ray_count]                              written; at most max_hits, which is at least 1

#include "traverse.cl"

kernel void count_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global int *restrict counts, const int ray_count,
    const global int *restrict order, const int max_hits)
{
    const int item = get_global_id(0);
    if (item >= ray_count) {
        return;
    }
    const int ray = number_of_ray(order, item);
    const path_t path = load_path(rays + item);
    search_t search = begin_search(max_hits, 0);
    traverse(nodes, groups, group_count, &path, &search, QUERY_COUNT);
    counts[ray] = search.count;
}

// How often each ray crosses the mesh between its t_min and its t_max.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// counts[ray_count]                              written; at most max_hits, which is at least 1

#include "traverse.cl"

kernel void count_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global int *restrict counts, const int ray_count, const int max_hits)
{
    const int ray = get_global_id(0);
    if (ray >= ray_count) {
        return;
    }
    const path_t path = load_path(rays + ray);
    search_t search = begin_search(max_hits, 0);
    traverse(nodes, groups, group_count, &path, &search, QUERY_COUNT);
    counts[ray] = search.count;
}

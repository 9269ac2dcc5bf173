// traverse, told that any crossing will do: which one is it?
//
// rays[count], nodes[node_count], groups[GROUP_COUNT]     in the order that run_shell has
// hits[count]                                             written

#include "traverse.cl"

kernel void find_any(
    const global ray_t *restrict rays, const global node_t *restrict nodes, const global group_t *restrict groups,
    global hit_t *restrict hits, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    search_t search = begin_search(1, 0);
    traverse(nodes, nodes, groups, GROUP_COUNT, &path, &search, QUERY_COUNT);
    hits[i] = as_hit(&search.nearest);
}

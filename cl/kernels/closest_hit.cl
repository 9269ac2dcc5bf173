// The nearest hit of each ray.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// order[ray_count]                               where results go: the number of each ray; without it its place
// hits[ray_count]                                written; t in units of the ray's direction

#include "traverse.cl"

kernel void closest_hit(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count,
    const global int *restrict order)
{
    const int item = get_global_id(0);
    if (item >= ray_count) {
        return;
    }
    const int ray = number_of_ray(order, item);
    const path_t path = load_path(rays + item);
    search_t search = begin_search(1, 0);
    traverse(nodes, groups, group_count, &path, &search, QUERY_CLOSEST);
    hits[ray] = as_hit(&search.nearest);
}

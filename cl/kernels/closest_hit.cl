// The nearest hit of each ray.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// width                                          rays in a row, see cl/batch.cl
// order[ray_count]                               where results go: the number of each ray; without it its place
// entries[tile_count]                            where each tile enters the tree, see cl/entry.cl; without, at the root
// hits[ray_count]                                written; t in units of the ray's direction

#include "entry.cl"

kernel void closest_hit(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count,
    const int width, const global int *restrict order, const global node_t *restrict entries)
{
    const int place = place_of_ray(width, ray_count);
    if (place == NO_RAY) {
        return;
    }
    const int ray = number_of_ray(order, place);
    const path_t path = load_path(rays + place);
    search_t search = begin_search(1, 0);
    traverse(nodes, find_start(nodes, entries), groups, group_count, &path, &search, QUERY_CLOSEST);
    hits[ray] = as_hit(&search.nearest);
}

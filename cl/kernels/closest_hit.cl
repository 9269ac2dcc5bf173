// The nearest hit of each ray between t_min and t_max; of equally near ones the smallest prim_id.
//
// Shared arguments: see cl/rays/batch.cl.
// hits[ray_count]     written by ray_id: t in lengths of the ray's direction; a miss has t INFINITY and prim_id NO_PRIM

#include "rays/batch.cl"
#include "traversal/entry_point.cl"

kernel void closest_hit(
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count,
    const global packed_ray_t *restrict rays, global kept_hit_t *restrict hits, const int ray_count,
    const int row_length, const global int *restrict order, const global node_t *restrict entry_points)
{
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const global node_t *start = find_start_node(nodes, entry_points);
    search_t search = make_search(1, 0);
    // Before the ray is loaded and prepared: many tiles of a picture meet nothing.
    if (meets_nothing(start)) {
        hits[ray_id] = as_kept_hit(&search, &search.nearest);
        return;
    }
    if (order) {
        WILL_WRITE(hits + ray_id);
    }
    const ray_t ray = load_ray(rays, ray_index);
    traverse(nodes, start, blocks, block_count, &ray, &search, QUERY_CLOSEST);
    hits[ray_id] = as_kept_hit(&search, &search.nearest);
}

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
    ray_t ray;
    const int ray_id = load_ray(rays, ray_count, row_length, order, &ray);
    if (ray_id == NO_RAY) {
        return;
    }
    search_t search = make_search(1, 0);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_CLOSEST);
    hits[ray_id] = as_kept_hit(&search, &search.nearest);
}

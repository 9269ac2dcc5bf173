// Whether anything lies on each ray between t_min and t_max.
//
// Shared arguments: see cl/rays/batch.cl.
// blocked[ray_count]     written: 1 or 0, by ray_id

#include "rays/batch.cl"
#include "traversal/entry_point.cl"

kernel void any_hit(
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count,
    const global packed_ray_t *restrict rays, global uchar *restrict blocked, const int ray_count,
    const int row_length, const global int *restrict order, const global node_t *restrict entry_points)
{
    ray_t ray;
    const int ray_id = load_ray(rays, ray_count, row_length, order, &ray);
    if (ray_id == NO_RAY) {
        return;
    }
    search_t search = make_search(1, 0);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_COUNT);
    blocked[ray_id] = search.count;
}

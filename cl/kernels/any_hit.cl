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
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const ray_t ray = load_ray(rays, ray_index);
    search_t search = make_search(1, 0);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_COUNT);
    blocked[ray_id] = search.count;
}

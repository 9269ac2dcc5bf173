// The number of hits of each ray between t_min and t_max.
//
// Shared arguments: see cl/rays/batch.cl.
// max_hits              limit of a count, at least 1; a ray that reaches it is not followed further
// counts[ray_count]     written by ray_id

#include "rays/batch.cl"
#include "traversal/entry_point.cl"

kernel void count_hits(
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count,
    const global packed_ray_t *restrict rays, global int *restrict counts, const int ray_count,
    const int row_length, const global int *restrict order, const global node_t *restrict entry_points,
    const int max_hits)
{
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const ray_t ray = load_ray(rays, ray_index);
    search_t search = make_search(max_hits, 0);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_COUNT);
    counts[ray_id] = search.count;
}

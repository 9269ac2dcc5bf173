// Whether each ray hits anything in a scene.
//
// Shared arguments: see cl/instances/traverse.cl and cl/instances/batch.cl.
// blocked[ray_count]     written by ray_id: 0 or 1

#include "instances/batch.cl"
#include "instances/start.cl"
#include "instances/traverse.cl"

kernel void scene_any_hit(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global block_t *restrict blocks, const global float *restrict spheres,
    const global packed_ray_t *restrict rays, const global scene_low_t *restrict lows, const int low_step,
    global uchar *restrict blocked, const int ray_count, const int row_length, const global int *restrict order,
    const global scene_tile_t *restrict tiles, const global node_t *restrict entry_points)
{
    scene_ray_pair_t ray;
    const int ray_id = load_scene_ray(rays, lows, low_step, ray_count, row_length, order, &ray);
    if (ray_id == NO_RAY) {
        return;
    }
    search_t search = make_search(1, 0);
    const scene_start_t start = find_scene_start(tiles, entry_points);
    traverse_scene(top_nodes, instances, nodes, blocks, spheres, start, &ray, &search, QUERY_COUNT);
    blocked[ray_id] = search.count > 0;
}

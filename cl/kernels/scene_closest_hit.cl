// The nearest hit of each ray in a scene; of equally near ones the smallest instance_id, then the smallest prim_id.
//
// Shared arguments: see cl/instances/traverse.cl and cl/instances/batch.cl.
// hits[ray_count]     written by ray_id: t in lengths of the ray's direction; a miss has t INFINITY and prim_id NO_PRIM

#include "instances/batch.cl"
#include "instances/start.cl"
#include "instances/traverse.cl"

kernel void scene_closest_hit(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global block_t *restrict blocks, const global float *restrict spheres,
    const global packed_ray_t *restrict rays, const global scene_low_t *restrict lows, const int low_step,
    global scene_hit_t *restrict hits, const int ray_count, const int row_length, const global int *restrict order,
    const global scene_tile_t *restrict tiles, const global node_t *restrict entry_points)
{
    scene_ray_pair_t ray;
    const int ray_id = load_scene_ray(rays, lows, low_step, ray_count, row_length, order, &ray);
    if (ray_id == NO_RAY) {
        return;
    }
    search_t search = make_search(1, 0);
    const scene_start_t start = find_scene_start(tiles, entry_points);
    traverse_scene(top_nodes, instances, nodes, blocks, spheres, start, &ray, &search, QUERY_CLOSEST);
    hits[ray_id] = as_kept_hit(&search, &search.nearest);
}

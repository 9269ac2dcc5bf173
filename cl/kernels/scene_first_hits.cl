// The first hits of each ray in a scene, in the order along it; ties are in the order of instance_id, then of prim_id.
//
// A ray that fills its slots may have more hits: the host casts it again with more slots.
//
// Shared arguments: see cl/instances/traverse.cl and cl/instances/batch.cl.
// slots                       results per ray, at least 1
// hits[ray_count * slots]     written: the hits of a ray begin at ray_id * slots; a miss (prim_id NO_PRIM) follows if
//                             slots are left, and further slots are not written

#include "instances/batch.cl"
#include "instances/start.cl"
#include "instances/traverse.cl"

kernel void scene_first_hits(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global block_t *restrict blocks, const global float *restrict spheres,
    const global packed_ray_t *restrict rays, const global scene_low_t *restrict lows, const int low_step,
    global scene_hit_t *restrict hits, const int ray_count, const int row_length, const global int *restrict order,
    const global scene_tile_t *restrict tiles, const global node_t *restrict entry_points, const int slots)
{
    scene_ray_pair_t ray;
    const int ray_id = load_scene_ray(rays, lows, low_step, ray_count, row_length, order, &ray);
    if (ray_id == NO_RAY) {
        return;
    }
    global scene_hit_t *hits_of_ray = hits + (size_t)ray_id * slots;
    search_t search = make_search(slots, hits_of_ray);
    const scene_start_t start = find_scene_start(tiles, entry_points);
    traverse_scene(top_nodes, instances, nodes, blocks, spheres, start, &ray, &search, QUERY_FIRST);
    sort_hits(&search);
    if (search.count < slots) {
        hits_of_ray[search.count].prim_id = NO_PRIM;
    }
}

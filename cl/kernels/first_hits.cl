// The first hits of each ray, in the order along it; ties are in the order of instance_id, then of prim_id.
//
// A ray that fills its slots may have more hits: the host casts it again with more slots.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// slots                       results per ray, at least 1
// hits[ray_count * slots]     written: the hits of a ray begin at ray_id * slots; a miss (prim_id NO_PRIM) follows if
//                             slots are left, and further slots are not written

#include "world/rays.cl"

kernel void first_hits(WORLD_ARGUMENTS, CAST_ARGUMENTS, global kept_hit_t *restrict hits, const int slots)
{
    const int ray_index = find_ray_index(get_global_id(0), get_global_id(1), ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const world_t world = WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX));
    const world_ray_t ray = load_ray(rays, lows, low_step, ray_index);
    global kept_hit_t *hits_of_ray = hits + (size_t)ray_id * slots;
    search_t search = make_search(slots, hits_of_ray);
    traverse_world(&world, &ray, true, &search, QUERY_FIRST);
    sort_hits(&search);
    if (search.count < slots) {
        hits_of_ray[search.count].prim_id = NO_PRIM;
    }
}

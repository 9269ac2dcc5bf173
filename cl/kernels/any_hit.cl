// Whether anything lies on each ray between t_min and t_max.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// blocked[ray_count]     written: 1 or 0, by ray_id

#include "world/rays.cl"

kernel void any_hit(WORLD_ARGUMENTS, CAST_ARGUMENTS, global uchar *restrict blocked)
{
    const int ray_index = find_ray_index(get_global_id(0), get_global_id(1), ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const world_t world = WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX));
    if (order) {
        WILL_WRITE(blocked + find_coming_ray_id(ray_index, ray_count, order));
    }
    const world_ray_t ray = load_ray(rays, lows, low_step, ray_index);
    search_t search = make_search(1, 0);
    traverse_world(&world, &ray, true, &search, QUERY_COUNT);
    blocked[ray_id] = search.count;
}

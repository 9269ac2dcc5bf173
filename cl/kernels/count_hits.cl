// The number of hits of each ray between t_min and t_max.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// max_hits              limit of a count, at least 1; a ray that reaches it is not followed further
// counts[ray_count]     written by ray_id

#include "world/rays.cl"

kernel void count_hits(WORLD_ARGUMENTS, CAST_ARGUMENTS, global int *restrict counts, const int max_hits)
{
    const int ray_index = find_ray_index(get_global_id(0), get_global_id(1), ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const world_t world = WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX));
    if (order) {
        WILL_WRITE(counts + find_coming_ray_id(ray_index, ray_count, order));
    }
    const world_ray_t ray = load_ray(rays, lows, low_step, ray_index);
    search_t search = make_search(max_hits, 0);
    traverse_world(&world, &ray, true, &search, QUERY_COUNT);
    counts[ray_id] = search.count;
}

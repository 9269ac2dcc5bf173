// The nearest hit of each ray between t_min and t_max; of equally near ones the smallest instance_id, then the smallest
// prim_id.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// hits[ray_count]     written by ray_id: t in lengths of the ray's direction; a miss has t INFINITY and prim_id NO_PRIM

#include "world/rays.cl"

kernel void closest_hit(WORLD_ARGUMENTS, CAST_ARGUMENTS, global kept_hit_t *restrict hits)
{
    const int ray_index = find_ray_index(get_global_id(0), get_global_id(1), ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const world_t world = WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX));
    search_t search = make_search(1, 0);
    // Before the ray is loaded and prepared: many tiles of a picture meet nothing.
    if (meets_nothing(&world.start)) {
        hits[ray_id] = as_kept_hit(&search, &search.nearest);
        return;
    }
    if (order) {
        WILL_WRITE(hits + find_coming_ray_id(ray_index, ray_count, order));
    }
    const world_ray_t ray = load_ray(rays, lows, low_step, ray_index);
    traverse_world(&world, &ray, true, &search, QUERY_CLOSEST);
    hits[ray_id] = as_kept_hit(&search, &search.nearest);
}

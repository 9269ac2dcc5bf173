// The nearest hit of each ray between t_min and t_max; of equally near ones the smallest instance_id, then the smallest
// prim_id.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// hits[ray_count]     written by ray_id: t in lengths of the ray's direction; a miss has t INFINITY and prim_id NO_PRIM

#include "world/rays.cl"

kernel void closest_hit(WORLD_ARGUMENTS, CAST_ARGUMENTS, global kept_hit_t *restrict hits)
{
    OPEN_BATCH;
    const world_t world = WORLD(batch.start);
    for (int slot = 0; slot < batch.count; slot++) {
        global kept_hit_t *own = hits + ray_id_of(&batch, slot);
        WILL_WRITE(own);
        search_t search = open_search(&batch, slot, 1, 0);
        // Before the ray is loaded and prepared: many tiles of a picture meet nothing.
        if (!meets_nothing(&world.start)) {
            const world_ray_t ray = load_ray(&batch, slot);
            traverse_world(&world, &ray, true, &search, QUERY_CLOSEST);
        }
        *own = as_kept_hit(&search, &search.nearest);
    }
}

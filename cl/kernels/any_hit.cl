// Whether anything lies on each ray between t_min and t_max.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// blocked[ray_count]     written: 1 or 0, by ray_id

#include "world/rays.cl"

kernel void any_hit(WORLD_ARGUMENTS, CAST_ARGUMENTS, global uchar *restrict blocked)
{
    OPEN_BATCH;
    const world_t world = WORLD(batch.start);
    for (int slot = 0; slot < batch.count; slot++) {
        global uchar *own = blocked + ray_id_of(&batch, slot);
        WILL_WRITE(own);
        const world_ray_t ray = load_ray(&batch, slot);
        search_t search = open_search(&batch, slot, 1, 0);
        traverse_world(&world, &ray, true, &search, QUERY_COUNT);
        *own = search.count;
    }
}
